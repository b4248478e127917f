"""A frame for posed photographs: z up as the cameras were held, the origin where they look."""

import numpy as np
from jaxtyping import Float64

_LEVEL = 0.3
"""How far the images' rows may be from level, as a share of how far they are spread."""
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

    Up is what all images' rows are perpendicular to, as of photographs held level; where there is no such direction,
    the mean of the images' upward directions. x is the right of the first camera. Where the cameras do not agree about up,
    as of photographs turned at random, the axes stay.
    """
    mean = -poses[:, 1, :3].mean(axis=0)
    rotation = np.eye(3)
    if np.linalg.norm(mean) >= _SLANTED:
        _, spread, axes = np.linalg.svd(poses[:, 0, :3])
        level = spread[2] < _LEVEL * spread[1]
        up = axes[2] * np.sign(axes[2] @ mean) if level else mean / np.linalg.norm(mean)
        right = poses[0, 0, :3] - up * (poses[0, 0, :3] @ up)
        if np.linalg.norm(right) > 1e-6:
            right /= np.linalg.norm(right)
            rotation = np.stack([right, np.cross(up, right), up])
    return np.concatenate([rotation, -(rotation @ looked_at(poses))[:, None]], axis=1)
