"""A frame for posed photographs: z up as the cameras were held, the origin where they look."""

import numpy as np
from jaxtyping import Float64

_LEVEL = 0.3
"""How far the images' rows may be from one plane, as a share of how far they are spread in it."""
_SLANTED = 0.2
"""Length of the images' mean upward direction below which they do not agree about it."""


def centers(poses: Float64[np.ndarray, "n 4 4"]) -> Float64[np.ndarray, "n 3"]:
    """Positions in the world of cameras given from world to camera."""
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])


def looked_at(poses: Float64[np.ndarray, "n 4 4"]) -> Float64[np.ndarray, " 3"]:
    """The point nearest to all optical axes, by least squares."""
    across = np.eye(3) - np.einsum("ni,nj->nij", poses[:, 2, :3], poses[:, 2, :3])
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centers(poses)), rcond=None)[0]


def upright_frame(poses: Float64[np.ndarray, "n 4 4"]) -> Float64[np.ndarray, "3 4"]:
    """Rotation and shift from the poses' world to one whose z is up and whose origin is what the cameras look at.

    Up is what all images' rows are perpendicular to, as of photographs held level, or, where that fits better, what
    all their columns are perpendicular to, as of a camera on its side: then up is where the cameras are. Where neither
    fits it is the mean of the images' upward directions; where they do not agree about one, z stays. x is the first
    camera's right.
    """
    mean, middle = -poses[:, 1, :3].mean(axis=0), looked_at(poses)
    across, rows = _across(poses[:, 0, :3])
    along, columns = _across(poses[:, 1, :3])
    if columns < min(rows, _LEVEL):
        up = along * _sign(along @ (centers(poses).mean(axis=0) - middle))
    elif np.linalg.norm(mean) < _SLANTED:
        up = np.array([0.0, 0.0, 1.0])
    elif rows < _LEVEL:
        up = across * _sign(across @ mean)
    else:
        up = mean / np.linalg.norm(mean)
    # Of two directions across, the one that is farther from up.
    ahead = max(poses[0, 0, :3], poses[0, 2, :3], key=lambda way: np.linalg.norm(np.cross(up, way)))
    right = ahead - up * (ahead @ up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(up, right), up])
    return np.concatenate([rotation, -(rotation @ middle)[:, None]], axis=1)


def _across(ways: Float64[np.ndarray, "n 3"]) -> tuple[Float64[np.ndarray, " 3"], float]:
    """The direction that all ``ways`` are most nearly perpendicular to, and how far they are from being so."""
    _, spread, axes = np.linalg.svd(ways)
    return axes[2], float(spread[2] / max(spread[1], 1e-9))


def _sign(value: float) -> float:
    return 1.0 if value >= 0 else -1.0
