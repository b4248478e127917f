"""Rays of pixels through the cells of a volume: the loops, for the CPU."""

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
def ask_rays(wanted, pose, lens, position, allowed, full, values, origin, cell, asked):
    """Mark in ``asked`` [x, y, z], for each ``wanted`` pixel [h, w] of a view whose ray meets nothing ``full``, the
    ``allowed`` cell along it with the smallest of ``values``."""
    size = np.array(full.shape, np.float32) * cell
    step = _HALF * cell
    for row in prange(wanted.shape[0]):
        way = np.empty(3, np.float32)
        for column in range(wanted.shape[1]):
            if not wanted[row, column]:
                continue
            first, last = _span(pose, lens, position, row, column, origin, size, way)
            depth, least, met = first + _HALF * step, np.float32(np.inf), False
            best = np.int32(-1), np.int32(-1), np.int32(-1)
            while depth < last and not met:
                i, j, k = _cell_at(position, way, depth, origin, cell)
                if 0 <= i < full.shape[0] and 0 <= j < full.shape[1] and 0 <= k < full.shape[2]:
                    met = full[i, j, k]
                    if allowed[i, j, k] and values[i, j, k] < least:
                        least, best = values[i, j, k], (i, j, k)
                depth += step
            if not met and best[0] >= 0:
                asked[best[0], best[1], best[2]] = True
