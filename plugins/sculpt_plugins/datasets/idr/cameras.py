"""Cameras from the projection matrices of cameras.npz.

``world_mat_I`` is K [R | t]: homogeneous world points to pixels whose centres are whole numbers, which is half a pixel
off this project's. ``scale_mat_I`` maps the unit ball that holds the object into the world.
"""

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy import linalg

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.lens import Pinhole
from sculpt_framework.types import Box

NAMES = ("cameras_sphere.npz", "cameras.npz", "cameras_large.npz")
_SKEW = 1e-3
"""Of the focal length: pixels are squares or rectangles, and what exceeds this is no rounding."""
_FARTHEST = 1e9


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedCamera:
    pinhole: Pinhole
    world_to_camera: Float64[np.ndarray, "4 4"]


def read_matrices(path: Path) -> dict[str, Float64[np.ndarray, "4 4"]]:
    """All ``world_mat`` and ``scale_mat`` of a file. Raises DataError for a file or a matrix that is none."""
    found: dict[str, np.ndarray] = {}
    try:
        # Opened here, as the reader leaves a file open that is no archive.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            for name in archive.files:
                if re.fullmatch(r"(world|scale)_mat_\d+", name):
                    found[name] = np.asarray(archive[name], np.float64)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except (ValueError, zipfile.BadZipFile, KeyError, EOFError, TypeError, zipfile.LargeZipFile) as error:
        raise DataError(f"{path}: not an archive of arrays ({error}); copy or write it again.") from None
    except Exception as error:  # The decompressor and the array reader raise what damage makes them stumble over.
        raise DataError(f"{path}: the archive is damaged ({error or type(error).__name__}); copy it again.") from None
    if not any(name.startswith("world_mat") for name in found):
        raise DataError(f"{path}: no world_mat_0; expected a projection matrix for each image.")
    for name, matrix in found.items():
        if matrix.shape not in ((4, 4), (3, 4)):
            raise DataError(f"{path}: {name} has shape {matrix.shape}; expected 4 x 4.")
        if not np.isfinite(matrix).all():
            raise DataError(f"{path}: {name} holds a number that is not finite.")
        if np.abs(matrix).max() > _FARTHEST:
            raise DataError(f"{path}: {name} holds {np.abs(matrix).max():.3g}; expected a camera near the object.")
    return {name: np.concatenate([matrix[:3], [[0, 0, 0, 1.0]]]) for name, matrix in found.items()}


def placed_camera(matrix: Float64[np.ndarray, "4 4"], where: str) -> PlacedCamera:
    """Taken apart. Raises DataError where it is not the product of a pinhole and a rigid motion."""
    left = matrix[:3, :3]
    sizes = np.linalg.svd(left, compute_uv=False)
    if sizes[2] <= 1e-9 * max(sizes[0], 1e-300):
        raise DataError(f"{where} is singular; expected K [R | t].")
    # A projection matrix is known up to a factor, which may be negative.
    factor = np.sign(np.linalg.det(left))
    inner, rotation = linalg.rq(factor * left)
    signs = np.diag(np.sign(np.diag(inner)))
    inner, rotation = inner @ signs, signs @ rotation
    translation = np.linalg.solve(inner, factor * matrix[:3, 3])
    inner = inner / inner[2, 2]
    if abs(inner[0, 1]) > _SKEW * inner[0, 0]:
        raise DataError(f"{where} has pixels that are sheared by {inner[0, 1] / inner[0, 0]:.2g}; expected rectangles.")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    pinhole = Pinhole(fx=inner[0, 0], fy=inner[1, 1], cx=inner[0, 2] + 0.5, cy=inner[1, 2] + 0.5)
    return PlacedCamera(pinhole=pinhole, world_to_camera=pose)


def ball_box(matrices: Mapping[str, Float64[np.ndarray, "4 4"]], path: Path) -> Box | None:
    """The box around the ball that ``scale_mat_0`` makes of the unit ball; None if there is no such matrix."""
    matrix = matrices.get("scale_mat_0")
    if matrix is None:
        return None
    radii, center = np.linalg.norm(matrix[:3, :3], axis=1), matrix[:3, 3]
    if radii.min() <= 1e-9 * max(radii.max(), 1e-300):
        raise DataError(f"{path}: scale_mat_0 is singular; expected the ball that holds the object.")
    return Box.between(center - radii, center + radii)
