"""An object in cells, found by depths: the pieces above what it stands on that most depths lie on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy import ndimage

from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps
from sculpt_framework.posed_images.support import Plane
from sculpt_framework.shape_from_images.volume import Volume

CLEAR = 0.01
"""Above the plane it stands on, in units of the box's half side, the object begins."""
_OWN, GROWN = 0.1, 2
"""Pieces with so many of the depths that the largest has belong to the object, too; a depth is a piece's within so many
cells."""
_AIMED = 0.2
"""Shares of an image's sides from its middle within which depths count: photographs are taken of the object."""
_WALLED, _ROOM, _OPEN = 0.1, 5, 3
"""What takes up more than this share of so many of the six walls of the space is a room, or a table, not an object:
the first where the space is known to hold the object, of which there may be more beyond it, the second elsewhere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """The object in cells."""

    volume: Volume
    inside: Bool[np.ndarray, "x y z"]
    seen: Bool[np.ndarray, "x y z"]
    """Near what some view sees."""
    planes: list[Plane]
    """What it stands on or before, which is cut away."""
    known: str
    """What there is of depths, in words."""
    maps: DepthMaps
    """All depths."""
    plain: bool = False
    """Whether it is not what has depths, but what hardly any view sees through."""


def cloud(
    maps: DepthMaps,
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """All depths as points with normals, and how much each is in the middle of its image."""
    points, normals, aimed = [], [], []
    for view, (depths, facing) in enumerate(zip(maps.depths, maps.normals, strict=True)):
        rows, columns = np.nonzero(depths > 0)
        fx, fy, cx, cy = maps.views.lenses[view].tolist()
        height, width = maps.views.sizes[view].tolist()
        off = np.hypot((columns + 0.5) / width - 0.5, (rows + 0.5) / height - 0.5)
        aimed.append(np.exp(-0.5 * (off / _AIMED) ** 2))
        rays = np.stack([(columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(len(rows))], axis=1)
        turn, shift = maps.views.poses[view, :, :3].astype(float), maps.views.poses[view, :, 3].astype(float)
        points.append((rays * depths[rows, columns, None] - shift) @ turn)
        normals.append(facing[rows, columns].astype(float) @ turn)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(aimed)


def pieces(
    shape: Volume, points: Float64[np.ndarray, "n 3"], aimed: Float64[np.ndarray, " n"], planes: Sequence[Plane]
) -> tuple[Bool[np.ndarray, "x y z"], Bool[np.ndarray, " n"]]:
    """The cells of the pieces above the planes that most points lie on, by their weights ``aimed``, without bubbles;
    and which points these are, none if there are no such pieces."""
    inside, counted = (shape.values < 0) & above(planes, shape), np.ones(len(points), bool)
    for plane in planes:
        counted &= plane.height(points) > 2 * CLEAR
    labels = np.zeros(inside.shape, np.int32)
    ndimage.label(inside, output=labels)
    near = ndimage.grey_dilation(labels, size=2 * GROWN + 1)
    cells = np.floor((points - np.array(shape.origin)) / shape.cell).astype(np.int64)
    counted &= ((cells >= 0) & (cells < np.array(shape.shape))).all(axis=1)
    held = np.zeros(len(points), np.int32)
    held[counted] = near[tuple(cells[counted].T)]
    counts = np.bincount(held, aimed, minlength=int(labels.max()) + 1)
    counts[0] = 0
    own = (counts > 0) & (counts >= _OWN * counts.max())
    return np.asarray(ndimage.binary_fill_holes(own[labels]), dtype=bool), own[held]


def above(planes: Sequence[Plane], volume: Volume) -> Bool[np.ndarray, "x y z"]:
    """The cells that are above all of the planes."""
    free, middles = np.ones(volume.shape, bool), volume.points.astype(float)
    for plane in planes:
        free &= (plane.height(middles) > CLEAR).reshape(volume.shape)
    return free


def fills_space(inside: Bool[np.ndarray, "x y z"], *, sure: bool) -> bool:
    """Whether this is no object but a room, or a table; ``sure`` where the space is known to hold the object."""
    walls = [wall for axis in range(3) for wall in (inside.take(0, axis), inside.take(-1, axis))]
    return sum(bool(wall.mean() > _WALLED) for wall in walls) >= (_ROOM if sure else _OPEN)
