"""A checkpoint: a state, and where the run stood. On disk one safetensors file, never half written."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.parameters import state_below

FORMAT = 1
FILE_NAME = "latest.safetensors"
_BEST = "best/"


@dataclass(frozen=True, kw_only=True)
class Progress:
    """With the method's state, all that resuming needs."""

    outer: int
    """Steps taken."""
    progress: float
    """Share of the run that is done."""
    trained_seconds: float
    best_psnr: float | None
    """Of the best state, whose tensors are saved beside the latest."""
    rate_scale: float
    recoveries: int
    milestones: list[dict[str, Any]]


Saved = tuple[Mapping[str, Tensor], Progress]
"""A checkpoint: the latest state with the best one (``with_best``), and where the run stood."""


def with_best(latest: Mapping[str, Tensor], best: Mapping[str, Tensor] | None) -> dict[str, Tensor]:
    """Two states as one, to be saved in one file: they must never be of different ages."""
    return {**latest, **{f"{_BEST}{name}": value for name, value in (best or {}).items()}}


def split_best(state: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Inverse of ``with_best``; the second is empty where there was none."""
    latest = {name: value for name, value in state.items() if not name.startswith(_BEST)}
    best = state_below(state, _BEST)
    return latest, best


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
