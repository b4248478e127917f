"""transforms_SPLIT.json of the NeRF-Synthetic layout."""

from pathlib import Path

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.folders import contents
from sculpt_framework.posed_images.image_files import LEAST
from sculpt_framework.posed_images.transforms import Frame, read_frames


def read_split(folder: Path, split: str, *, least: int = LEAST) -> tuple[list[Frame], list[str]]:
    """The frames of a split and notes on what was unusual about them.

    Raises DataError for the first thing that is missing or malformed, naming file and frame, and where missing images
    leave fewer than ``least`` frames.
    """
    path = folder / f"transforms_{split}.json"
    if not path.is_file():
        raise DataError(f"{folder}: no {path.name}; found {_contents(folder)}.")
    return read_frames(path, split, least=least)


def _contents(folder: Path) -> str:
    """What is in a folder, for people who gave the wrong one."""
    nested = sorted(path.parent.name for path in folder.glob("*/transforms_train.json"))
    return f"scenes inside it ({', '.join(nested[:4])}): give one of them" if nested else contents(folder)
