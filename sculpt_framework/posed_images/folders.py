"""The folder a user named, and what is in it when it is the wrong one."""

from pathlib import Path

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.reading import in_short


def scene_folder(data: str) -> Path:
    """``data`` as a folder. Raises DataError if it is none or cannot be listed."""
    if not data:
        raise DataError("no data given; expected --data FOLDER, --data demo or --data demo:NAME.")
    try:
        folder = Path(data).expanduser()
        if folder.is_dir():
            next(folder.iterdir(), None)
            return folder
        exists = folder.exists()
    except (OSError, RuntimeError, ValueError) as error:
        raise DataError(f"{data}: the folder cannot be read ({error}).") from None
    if exists:
        raise DataError(f"{data}: is a file; give the folder it is in.")
    raise DataError(f"{data}: no such folder; expected a scene folder, or demo, or demo:NAME.")


def contents(folder: Path) -> str:
    """A few names of what is in a folder."""
    names = sorted(path.name + ("/" if path.is_dir() else "") for path in folder.iterdir())
    if not names:
        return "an empty folder"
    return in_short(names, 6)
