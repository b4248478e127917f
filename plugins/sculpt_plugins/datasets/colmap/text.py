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
        if number in cameras:
            raise DataError(f"{where}: there is a camera {number} before; expected numbers of their own.")
        cameras[number] = checked_camera(model, width, height, values, where)
    return cameras


def read_images(path: Path) -> list[SparseImage]:
    """Raises DataError for a line that is no image, and for a pose that is none.

    COLMAP writes a second line for each image, its observations, blank where there are none; other programs leave it
    out. A line of observations ends in a number, that of an image in a name.
    """
    images: list[SparseImage] = []
    numbers: dict[int, str] = {}
    follows = False
    for where, line in _lines(path):
        words = line.split(maxsplit=9)
        if not words or (follows and _are_observations(line)):
            follows = False
            continue
        if len(words) != 10:
            raise DataError(
                f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, or behind it the image's "
                f"observations, X Y POINT3D_ID each; found {line[:60]!r}."
            )
        number, camera = _whole(words[0], where), _whole(words[8], where)
        values = [_real(word, where) for word in words[1:8]]
        image = SparseImage(name=words[9], camera=camera, world_to_camera=pose(values, where))
        if numbers.setdefault(number, image.name) != image.name:
            raise DataError(f"{where}: image {number} is {image.name} here and {numbers[number]} before.")
        images.append(image)
        follows = True
    return images


def _are_observations(line: str) -> bool:
    """An image's line may have as many words, where its name has spaces, but they are not all numbers."""
    words = line.split()
    try:
        numbers = [float(word) for word in (*words[:12], *words[-3:])]
    except ValueError:
        return False
    return len(words) % 3 == 0 and all(point.is_integer() for point in numbers[2::3])


def read_points(path: Path) -> Float64[np.ndarray, "n 3"]:
    """Positions, which may be not finite. Raises DataError for a line that is no point."""
    points = []
    for where, line in _lines(path):
        words = line.split(maxsplit=4)
        if not words:
            continue
        if len(words) < 4:
            raise DataError(f"{where}: expected POINT3D_ID X Y Z ...; found {line[:60]!r}.")
        points.append([_real(word, where) for word in words[1:4]])
    return np.array(points, np.float64).reshape(-1, 3)


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Where each line is, for errors, and its text; comments are left out, blank lines are not."""
    text = read_text(path, "a model that COLMAP wrote as text")
    # Names may hold what else counts as the end of a line.
    for number, line in enumerate(text.split("\n"), start=1):
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
