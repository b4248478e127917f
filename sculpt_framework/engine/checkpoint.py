"""A checkpoint: one safetensors file, progress and version in its header, never half written."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from sculpt_framework.engine.progress import Progress
from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.atomic import write_atomically

FORMAT = 1
FILE_NAME = "latest.safetensors"


def write_checkpoint(folder: Path, state: Mapping[str, Tensor], progress: Progress) -> None:
    """Replace the folder's checkpoint. Raises OutputError if it cannot be written; the old one is whole then."""
    header = {"format": str(FORMAT), "progress": json.dumps(asdict(progress))}
    tensors = {name: tensor.detach().cpu() for name, tensor in state.items()}
    write_atomically(folder / FILE_NAME, save(tensors, metadata=header))


def read_checkpoint(folder: Path) -> tuple[dict[str, Tensor], Progress]:
    """Raises CheckpointError if there is none, if it is damaged, or if another version wrote it."""
    path = folder / FILE_NAME
    if not path.is_file():
        raise CheckpointError(f"no checkpoint at {path}; the run stopped before its first one, so start it anew")
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path} is damaged and cannot be read ({error})") from error
    if header.get("format") != str(FORMAT):
        raise CheckpointError(
            f"{path} has checkpoint format {header.get('format')}, this version reads {FORMAT}; "
            "resume with the version that wrote it"
        )
    try:
        progress = Progress(**json.loads(header["progress"]))
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path} has no valid progress in its header ({error})") from error
    return state, progress
