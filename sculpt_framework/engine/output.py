"""The run directory: where it is, and whether it can be used, asked before any work is done."""

import os
import re
import tempfile
from datetime import datetime
from pathlib import Path

from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import OutputError

ROOT = Path("outputs")
CONFIG_NAME = "config.json"
MESH_NAME = "mesh.ply"


def check_output(config: MethodConfig) -> None:
    """Raise OutputError if the run directory cannot be made, cannot be written or is not empty.

    Changes nothing on disk.
    """
    folder = config.output or ROOT
    try:
        _check_writable(folder)
        if config.output is not None and folder.is_dir() and any(folder.iterdir()):
            raise OutputError(
                f"--output {folder} is not empty. Give a new folder, or --resume {folder} to go on with the run in it."
            )
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}.") from error


def prepare_output(config: MethodConfig) -> Path:
    """Make the run directory and return it; outputs/SCENE/METHOD/TIME where the user named none.

    Raises OutputError if it cannot be made or written, or is not empty.
    """
    check_output(config)
    try:
        if config.output is None:
            folder = _new_folder(ROOT / scene_name(config.data) / config.method)
        else:
            folder = config.output
            folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"cannot write to {error.filename or config.output}: {error.strerror}.") from error
    return folder


def scene_name(data: str) -> str:
    """What to call the scene given as ``--data``: the folder's name, or the demo's; letters a file system can take."""
    last = data.removeprefix("demo:") if data.startswith("demo:") else os.path.basename(os.path.abspath(data))
    return re.sub(r"[^\w.-]+", "-", last).strip("-.")[:100] or "scene"


def _new_folder(parent: Path) -> Path:
    """A folder named by the time; a second one in the same second gets a number."""
    time = datetime.now().strftime("%Y-%m-%d_%H%M%S")
    parent.mkdir(parents=True, exist_ok=True)
    number = 1
    while True:
        folder = parent / (time if number == 1 else f"{time}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
        else:
            return folder


def _check_writable(folder: Path) -> None:
    """Whether ``folder``, or the nearest folder above it that exists, can be written."""
    nearest = folder.absolute()
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        raise OutputError(f"cannot write to {folder}: {nearest} is not a folder.")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write to {folder}: no permission in {nearest}.")
