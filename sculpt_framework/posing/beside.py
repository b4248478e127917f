"""Posing as a part of reading a scene: into a folder beside the photographs, which later runs read."""

import os
from pathlib import Path

from sculpt_framework.errors import DataError, OutputError
from sculpt_framework.posing.console import ConsoleAnnouncer
from sculpt_framework.posing.options import PosingOptions
from sculpt_framework.posing.pose import WORK, pose


def pose_beside(data: Path) -> tuple[Path, str]:
    """The posed scene of photographs or a video, made now if it is not there yet, and a note of what came of it.

    Raises as ``pose``, and DataError for a scene that ``pose`` has not finished.
    """
    if (data / WORK).is_dir():
        raise DataError(
            f"{data}: its cameras are not found yet; sculpt-data pose PHOTOS --out {data}, with the photographs it was "
            "begun with, goes on."
        )
    folder = posed_folder(data)
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK | os.X_OK):
        raise OutputError(
            f"{data} has no cameras, and {folder} cannot be written; sculpt-data pose {data} --out SCENE finds them, "
            "with a folder of your choice for --data."
        )
    with ConsoleAnnouncer() as announcer:
        known = (folder / "sparse" / "0").is_dir()
        if not known:
            announcer.say(f"{data} has no cameras: they are looked for now, and kept in {folder}")
        outcome = pose(data, folder, PosingOptions(), announcer)
        if not known:
            for line in outcome.lines(folder):
                announcer.say(f"  {line}")
    few = "only " if 2 * outcome.registered < outcome.photographs else ""
    found = f"{few}{outcome.registered} of {outcome.photographs} photographs, {outcome.error_px:.2f} px"
    return folder, f"cameras of {found}, were found by pycolmap; they are in {folder}."


def posed_folder(data: Path) -> Path:
    """``NAME-posed`` beside the data."""
    whole = Path(os.path.abspath(data))
    return whole.with_name(f"{whole.stem if whole.is_file() else whole.name}-posed")
