"""Rays of pixels through the cells of a volume, and cells in pixels: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_HALF, _ZERO = np.float32(0.5), np.float32(0)
_NEAR = np.float32(1e-4)
_FAR = np.float32(1e9)


@njit(forceinline=True, **_OPTIONS)
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


@njit(forceinline=True, **_OPTIONS)
def _is_in(solid, position, way, depth, origin, cell):
    """Whether what a ray has come to at some depth is ``solid``."""
    i = np.int32((position[0] + depth * way[0] - origin[0]) / cell)
    j = np.int32((position[1] + depth * way[1] - origin[1]) / cell)
    k = np.int32((position[2] + depth * way[2] - origin[2]) / cell)
    return 0 <= i < solid.shape[0] and 0 <= j < solid.shape[1] and 0 <= k < solid.shape[2] and solid[i, j, k]


@njit(forceinline=True, **_OPTIONS)
def _enters(solid, position, way, depth, last, step, origin, cell):
    """The first depth, from ``depth`` on, at which a ray is in what is ``solid``; ``last`` or more if none is."""
    while depth < last and not _is_in(solid, position, way, depth, origin, cell):
        depth += step
    return depth


@njit(**_OPTIONS)
def mark_met(inside, pose, lens, position, solid, origin, cell, met):
    """Fill ``met`` [h, w] with whether a pixel is inside and its ray meets what is ``solid``."""
    size = np.array(solid.shape, np.float32) * cell
    step = _HALF * cell
    way = np.empty(3, np.float32)
    for row in range(met.shape[0]):
        for column in range(met.shape[1]):
            met[row, column] = False
            if not inside[row, column]:
                continue
            first, last = _span(pose, lens, position, row, column, origin, size, way)
            met[row, column] = _enters(solid, position, way, first + _HALF * step, last, step, origin, cell) < last


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
            depth = _enters(solid, position, way, first + _HALF * step, last, step, origin, cell)
            if depth < last:
                nearest[row, column] = max(depth - cell, _NEAR)
            while depth < last:
                if _is_in(solid, position, way, depth, origin, cell):
                    farthest[row, column] = depth + cell
                depth += step


@njit(forceinline=True, **_OPTIONS)
def _pixel(points, n, pose, lens, height, width):
    """The depth, row and column at which a point is seen; a row of -1 where it is not."""
    x, y, z = points[n, 0], points[n, 1], points[n, 2]
    far = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    right = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
    down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
    u, v = lens[0] * right / far + lens[2], lens[1] * down / far + lens[3]
    if far > _NEAR and u >= 0 and v >= 0 and u < np.float32(width) and v < np.float32(height):
        return far, np.int32(v), np.int32(u)
    return far, np.int32(-1), np.int32(-1)


@njit(parallel=True, **_OPTIONS)
def count_missing(points, open_parts, depths, poses, lenses, back, least, surplus):
    """How many more of the ``open_parts`` [v, h, w] a point lies in than there are views which see something more than
    ``back`` behind it, and one; 0 where there are less than ``least`` of the former, or more of the latter."""
    height, width = open_parts.shape[1], open_parts.shape[2]
    for n in prange(points.shape[0]):
        asking, through = 0, 0
        for i in range(open_parts.shape[0]):
            far, row, column = _pixel(points, n, poses[i], lenses[i], height, width)
            if row >= 0:
                asking += open_parts[i, row, column]
                through += depths[i, row, column] > far + back
        surplus[n] = asking - through + 1 if asking >= least and asking >= through else 0


@njit(**_OPTIONS)
def most_on_rays(points, surplus, open_part, pose, lens, most):
    """Raise ``most`` [h, w], of one view, to the largest surplus of the points seen at each of its open pixels."""
    height, width = open_part.shape
    for n in range(points.shape[0]):
        _, row, column = _pixel(points, n, pose, lens, height, width)
        if row >= 0 and open_part[row, column]:
            most[row, column] = max(most[row, column], surplus[n])


@njit(parallel=True, **_OPTIONS)
def choose_missing(points, surplus, open_parts, most, poses, lenses, share, least, chosen):
    """Mark the points that have this ``share`` of the largest surplus, ``most`` [v, h, w], in ``least`` of the open
    parts or more."""
    height, width = open_parts.shape[1], open_parts.shape[2]
    for n in prange(points.shape[0]):
        leading = 0
        for i in range(open_parts.shape[0]):
            _, row, column = _pixel(points, n, poses[i], lenses[i], height, width)
            if row >= 0 and open_parts[i, row, column]:
                leading += np.float32(surplus[n]) >= share * np.float32(most[i, row, column])
        chosen[n] = leading >= least
