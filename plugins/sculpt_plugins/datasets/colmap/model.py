"""What a sparse model holds, and where it is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.folders import contents
from sculpt_plugins.datasets.colmap.lenses import Model

PLACES = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", ".")
"""Where a model may lie below the data folder."""
FARTHEST = 1e9
"""World units; beyond, float32 keeps no digits of a position."""


@dataclass(frozen=True, kw_only=True)
class SparseCamera:
    model: Model
    width: int
    height: int
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseImage:
    name: str
    """Path relative to the folder of images."""
    camera: int
    world_to_camera: Float64[np.ndarray, "4 4"]
    """OpenCV axes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseModel:
    cameras: Mapping[int, SparseCamera]
    images: Sequence[SparseImage]
    points: Float64[np.ndarray, "n 3"]
    notes: tuple[str, ...] = ()
    """On the points."""


def find_model(folder: Path, place: str) -> Path:
    """The folder of the model. Raises DataError where there is none.

    COLMAP numbers the pieces it could not join; where there are several the one with the largest file of images is
    taken, which is the one with most of them.
    """
    if place:
        if not is_model(folder / place):
            raise DataError(f"{folder / place}: no sparse model; expected cameras and images as .bin or .txt files.")
        return folder / place
    numbered = [path for path in sorted((folder / "sparse").glob("[0-9]*")) if is_model(path)]
    if len(numbered) > 1:
        return max(numbered, key=lambda path: _images_file(path).stat().st_size)
    for known in PLACES:
        if is_model(folder / known):
            return folder / known
    raise DataError(f"{folder}: no sparse model in {', '.join(PLACES[:-1])}; found {contents(folder)}.")


def is_model(folder: Path) -> bool:
    """Whether a folder holds cameras and images of a model."""
    return any((folder / f"cameras{end}").is_file() and (folder / f"images{end}").is_file() for end in (".bin", ".txt"))


def _images_file(folder: Path) -> Path:
    binary = folder / "images.bin"
    return binary if binary.is_file() else folder / "images.txt"


def pose(values: Sequence[float], where: str) -> Float64[np.ndarray, "4 4"]:
    """From qw qx qy qz tx ty tz. Raises DataError where that is no rotation and position."""
    if not np.isfinite(values).all():
        raise DataError(f"{where}: the pose holds a number that is not finite.")
    quaternion, translation = np.array(values[:4]), np.array(values[4:7])
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > 1e-2:
        raise DataError(f"{where}: the quaternion has length {length:.3g}; expected 1.")
    if np.abs(translation).max() > FARTHEST:
        raise DataError(
            f"{where}: the position holds {np.abs(translation).max():.3g}; expected a camera near the object."
        )
    w, x, y, z = quaternion / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = translation
    return matrix


def checked_camera(model: Model, width: int, height: int, values: Sequence[float], where: str) -> SparseCamera:
    """Raises DataError for a size or values that no camera has."""
    if not (0 < width <= 1 << 20 and 0 < height <= 1 << 20):
        raise DataError(f"{where}: the size is {width}x{height}; expected pixels, more than 0.")
    if len(values) != model.parameters:
        raise DataError(f"{where}: {model.name} has {model.parameters} parameters; found {len(values)}.")
    if not np.isfinite(values).all():
        raise DataError(f"{where}: a parameter is not finite.")
    return SparseCamera(model=model, width=width, height=height, values=tuple(values))
