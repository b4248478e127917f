"""Rays of pixels through the cells of a volume, and cells in pixels: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_HALF, _ZERO = np.float32(0.5), np.float32(0)
_NEAR = np.float32(1e-4)
_FAR = np.float32(1e9)


@njit(inline="always", **_OPTIONS)
def _span(pose, lens, position, row, column, origin, size, way):
    """Fill ``way`` with the ray of a pixel, of depth 1, and return the depths at which it enters and leaves the box."""
    x = (np.float32(column) + _HALF - lens[2]) / lens[0]
    y = (np.float32(row) + _HALF - lens[3]) / lens[1]
    first, last = _NEAR, _FAR
    for k in range(3):
        way[k] = pose[0, k] * x + pose[1, k] * y + pose[2, k]
        slope = way[k] if abs(way[k]) > np.float32(1e-9) else np.float32(1e-9)
        a, b = (origin[k] - position[k]) / slope, (origin[k] + size[k] - position[k]) / slope
        first, last = max(first, min(a, b)), min(last, max(a, b))
    return first, last


@njit(inline="always", **_OPTIONS)
def _cell_at(position, way, depth, origin, cell):
    return (
        np.int32((position[0] + depth * way[0] - origin[0]) / cell),
        np.int32((position[1] + depth * way[1] - origin[1]) / cell),
        np.int32((position[2] + depth * way[2] - origin[2]) / cell),
    )


@njit(**_OPTIONS)
def bound_depths(inside, pose, lens, position, solid, origin, cell, nearest, farthest):
    """Fill ``nearest`` and ``farthest`` [h, w] with the depths between which a pixel's ray meets what is ``solid``, a
    cell more on both sides; 0 where it does not, or the pixel is not inside."""
    size = np.array(solid.shape, np.float32) * cell
    # In depth a step is shorter than along the ray: no cell is missed by more than its corner.
    step = _HALF * cell
    way = np.empty(3, np.float32)
    for row in range(nearest.shape[0]):
        for column in range(nearest.shape[1]):
            nearest[row, column], farthest[row, column] = _ZERO, _ZERO
            if not inside[row, column]:
                continue
            first, last = _span(pose, lens, position, row, column, origin, size, way)
            depth = first + _HALF * step
            while depth < last:
                i, j, k = _cell_at(position, way, depth, origin, cell)
                if 0 <= i < solid.shape[0] and 0 <= j < solid.shape[1] and 0 <= k < solid.shape[2] and solid[i, j, k]:
                    if not farthest[row, column] > 0:
                        nearest[row, column] = max(depth - cell, _NEAR)
                    farthest[row, column] = depth + cell
                depth += step


@njit(parallel=True, **_OPTIONS)
def find_missing(points, wanted, open_parts, depths, poses, lenses, back, least, missing):
    """Mark the ``wanted`` points that lie in ``least`` of the ``open_parts`` [v, h, w] of views or more, and in as many
    as there are views which see something more than ``back`` behind them."""
    height, width = open_parts.shape[1], open_parts.shape[2]
    for n in prange(points.shape[0]):
        missing[n] = False
        if not wanted[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        asking, through = 0, 0
        for i in range(open_parts.shape[0]):
            far = poses[i, 2, 0] * x + poses[i, 2, 1] * y + poses[i, 2, 2] * z + poses[i, 2, 3]
            right = poses[i, 0, 0] * x + poses[i, 0, 1] * y + poses[i, 0, 2] * z + poses[i, 0, 3]
            down = poses[i, 1, 0] * x + poses[i, 1, 1] * y + poses[i, 1, 2] * z + poses[i, 1, 3]
            u, v = lenses[i, 0] * right / far + lenses[i, 2], lenses[i, 1] * down / far + lenses[i, 3]
            if far > _NEAR and u >= 0 and v >= 0 and u < np.float32(width) and v < np.float32(height):
                row, column = np.int32(v), np.int32(u)
                asking += open_parts[i, row, column]
                through += depths[i, row, column] > far + back
        missing[n] = asking >= least and asking >= through
