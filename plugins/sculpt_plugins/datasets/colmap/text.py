"""cameras.txt, images.txt and points3D.txt: a record a line, two lines for an image; lines with # are comments."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.reading import read_text
from sculpt_plugins.datasets.colmap.lenses import model_of
from sculpt_plugins.datasets.colmap.model import SparseCamera, SparseImage, checked_camera, pose


def read_cameras(path: Path) -> dict[int, SparseCamera]:
    """Raises DataError for a line that is no camera, and for a camera of no use."""
    cameras = {}
    for where, line in _lines(path):
        words = line.split()
        if not words:
            continue
        if len(words) < 5:
            raise DataError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS; found {line[:60]!r}.")
        model = model_of(words[1], where)
        number, width, height = (_whole(words[index], where) for index in (0, 2, 3))
        values = [_real(word, where) for word in words[4:]]
        cameras[number] = checked_camera(model, width, height, values, where)
    return cameras


def read_images(path: Path) -> list[SparseImage]:
    """Raises DataError for a line that is no image, and for a pose that is none."""
    images, lines = [], _lines(path)
    for where, line in lines:
        # Blank lines are points of an image with none, so only those between images are passed over.
        if not line:
            continue
        words = line.split(maxsplit=9)
        if len(words) != 10:
            raise DataError(f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; found {line[:60]!r}.")
        values = [_real(word, where) for word in words[1:8]]
        camera = _whole(words[8], where)
        images.append(SparseImage(name=words[9], camera=camera, world_to_camera=pose(values, where)))
        below, observations = next(lines, (where, ""))
        if len(observations.split()) % 3:
            raise DataError(
                f"{below}: expected the observations of {words[9]}, X Y POINT3D_ID each, or a blank line; found "
                f"{observations[:60]!r}."
            )
    return images


def read_points(path: Path) -> Float64[np.ndarray, "n 3"]:
    """Positions; those that are not finite are left out. Raises DataError for a line that is no point."""
    points = []
    for where, line in _lines(path):
        words = line.split(maxsplit=4)
        if not words:
            continue
        if len(words) < 4:
            raise DataError(f"{where}: expected POINT3D_ID X Y Z ...; found {line[:60]!r}.")
        points.append([_real(word, where) for word in words[1:4]])
    array = np.array(points, np.float64).reshape(-1, 3)
    return array[np.isfinite(array).all(axis=1)]


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Where each line is, for errors, and its text; comments are left out, blank lines are not."""
    text = read_text(path, "a model that COLMAP wrote as text")
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.startswith("#"):
            yield f"{path}: line {number}", line.strip()


def _whole(word: str, where: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise DataError(f"{where}: {word[:30]!r} is no whole number.") from None


def _real(word: str, where: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise DataError(f"{where}: {word[:30]!r} is no number.") from None
