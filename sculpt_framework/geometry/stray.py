"""Pieces of a mesh that do not belong to the object: specks outside, bubbles inside."""

import numpy as np
from jaxtyping import Bool, Float, Int64

from sculpt_framework.geometry.topology import components

_SPECK_AREA = 0.01
"""A piece with less than this share of the largest piece's area is a speck, unless it is a rod, whose joint was thinner
than the cells."""
_ROD_SIZE, _ROD_SHAPE = 0.05, 3.0
"""A rod is at least as long as this share of the largest piece, and the square of its length at least so many times its
area: it is some ten times as long as thick."""


def main_faces(vertices: Float[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Which faces belong to pieces of the object: not specks, and not turned inwards (the walls of a bubble).

    Keeps whole components, so a closed mesh stays closed. A mesh that is one piece is kept whatever it is.
    """
    if len(faces) == 0:
        return np.zeros(0, dtype=bool)
    count, piece = components(faces)
    if count == 1:
        return np.ones(len(faces), dtype=bool)
    corners = vertices[faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.bincount(piece, 0.5 * np.linalg.norm(cross, axis=1), minlength=count)
    middle = corners.reshape(-1, 3).mean(axis=0)
    volume = np.bincount(piece, np.einsum("fx,fx->f", corners[:, 0] - middle, cross), minlength=count)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(axis=1))
    np.maximum.at(high, piece, corners.max(axis=1))
    size = np.linalg.norm(high - low, axis=1)
    rod = (size >= _ROD_SIZE * size[area.argmax()]) & (size**2 >= _ROD_SHAPE * area)
    keep = ((area >= _SPECK_AREA * area.max()) | rod) & (volume > 0)
    keep[area.argmax()] = True
    return keep[piece]


def compact(
    vertices: Float[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "w 3"], Int64[np.ndarray, "f 3"], Int64[np.ndarray, " w"]]:
    """Drop vertices no face uses; also says which old vertex each new one is."""
    named = np.zeros(len(vertices), bool)
    named[faces] = True
    used = np.flatnonzero(named)
    return vertices[used], (np.cumsum(named) - 1)[faces], used
