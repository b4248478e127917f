"""The scene that cameras from a board make: images, transforms.json and frame.json."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sculpt_framework.errors import OutputError
from sculpt_framework.export.atomic import cannot_write, link_or_copy, write_atomically
from sculpt_framework.export.json_text import json_text
from sculpt_framework.frame import WorldFrame, write_frame
from sculpt_framework.markers.boards import Board
from sculpt_framework.markers.turntable import PosedPhotograph

IMAGES, TRANSFORMS = "images", "transforms.json"
_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def check_scene_folder(folder: Path, photographs: Path) -> None:
    """Raises OutputError where there is something that would be overwritten. A folder that holds nothing but the
    photographs, as ``images``, is fine.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise OutputError(f"--out {folder}: is a file; give a new folder.")
    there = {path.name for path in folder.iterdir()}
    own = {IMAGES, "masks"} if (folder / IMAGES).resolve() == photographs.resolve() else set()
    if there - own:
        raise OutputError(
            f"--out {folder}: holds {', '.join(sorted(there - own)[:3])}; give a new folder, or the one whose "
            f"{IMAGES}/ the photographs are."
        )


def write_scene(folder: Path, posed: Sequence[PosedPhotograph], board: Board) -> None:
    """The world is the board's frame: metres, z up. Photographs and masks are linked, or else copied, unless they are
    there already.

    Raises OutputError.
    """
    place = folder / IMAGES
    try:
        place.mkdir(parents=True, exist_ok=True)
        for item in posed:
            photograph = item.photograph
            link_or_copy(photograph.path, place / photograph.name)
            if photograph.mask is not None:
                link_or_copy(photograph.mask, folder / "masks" / f"{photograph.name}{photograph.mask.suffix}")
    except OSError as error:
        raise cannot_write(folder, error) from error
    document = {"camera_model": "OPENCV", "frames": [_frame(item) for item in posed]}
    evidence = {
        "scale_from": board.name,
        "up_from": board.name,
        "origin": [0.0, 0.0, 0.0],
        "side_mm": board.side,
        "residual_pixels": float(np.median([item.pose.pixel_error for item in posed])),
        "cameras": {
            f"{IMAGES}/{Path(item.photograph.name).with_suffix('').as_posix()}": item.pose.position.tolist()
            for item in posed[:5]
        },
    }
    write_frame(WorldFrame(metres_per_unit=1.0, up=(0.0, 0.0, 1.0), evidence=evidence), folder)
    # Last: a folder with this file is a scene.
    write_atomically(folder / TRANSFORMS, json_text(document, indent=1).encode() + b"\n")


def _frame(item: PosedPhotograph) -> dict[str, object]:
    lens = item.lens
    return {
        "file_path": f"{IMAGES}/{item.photograph.name}",
        "w": item.photograph.width,
        "h": item.photograph.height,
        "fl_x": lens.focal,
        "fl_y": lens.focal,
        "cx": lens.center[0],
        "cy": lens.center[1],
        "k1": lens.k1,
        "k2": lens.k2,
        "transform_matrix": (np.linalg.inv(item.pose.world_to_camera) @ _TO_OPENGL).tolist(),
    }
