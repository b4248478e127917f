"""Who sees a place on a surface, and how far a place is beyond planes: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_HALF, _NEAR = np.float32(0.5), np.float32(1e-6)


@njit(forceinline=True, **_OPTIONS)
def _free(inside, start, way, length, origin, cell, first):
    """Whether a ray of unit direction meets nothing ``inside`` from ``first`` cells on, for as long as it is or until
    it leaves the volume."""
    step = _HALF * cell
    reached = first * cell
    while reached < length:
        i = np.int32(np.floor((start[0] + reached * way[0] - origin[0]) / cell))
        j = np.int32(np.floor((start[1] + reached * way[1] - origin[1]) / cell))
        k = np.int32(np.floor((start[2] + reached * way[2] - origin[2]) / cell))
        if not (0 <= i < inside.shape[0] and 0 <= j < inside.shape[1] and 0 <= k < inside.shape[2]):
            return True
        if inside[i, j, k]:
            return False
        reached += step
    return True


@njit(parallel=True, **_OPTIONS)
def count_seeing(points, poses, lenses, sizes, positions, inside, origin, cell, first, counts):
    """Fill ``counts`` with how many views see each point: in their image (``sizes`` are rows and columns), and nothing
    ``inside`` [x, y, z] on the way from ``first`` cells in front of it."""
    for n in prange(points.shape[0]):
        point, way = points[n], np.empty(3, np.float32)
        counts[n] = 0
        for i in range(poses.shape[0]):
            right = poses[i, 0, 0] * point[0] + poses[i, 0, 1] * point[1] + poses[i, 0, 2] * point[2] + poses[i, 0, 3]
            down = poses[i, 1, 0] * point[0] + poses[i, 1, 1] * point[1] + poses[i, 1, 2] * point[2] + poses[i, 1, 3]
            far = poses[i, 2, 0] * point[0] + poses[i, 2, 1] * point[1] + poses[i, 2, 2] * point[2] + poses[i, 2, 3]
            if not far > _NEAR:
                continue
            u, v = lenses[i, 0] * right / far + lenses[i, 2], lenses[i, 1] * down / far + lenses[i, 3]
            if not (u >= 0 and v >= 0 and u <= np.float32(sizes[i, 1]) and v <= np.float32(sizes[i, 0])):
                continue
            length = np.float32(0)
            for k in range(3):
                way[k] = positions[i, k] - point[k]
                length += way[k] * way[k]
            length = np.sqrt(length)
            for k in range(3):
                way[k] /= length
            counts[n] += _free(inside, point, way, length, origin, cell, first)


@njit(parallel=True, **_OPTIONS)
def cut_by_planes(points, planes, values):
    """Raise the ``values`` below 0 to the distance of their point from the nearest of ``planes`` (unit normals and
    offsets, four numbers each), positive beyond any of them."""
    for n in prange(points.shape[0]):
        if not values[n] < 0:
            continue
        x, y, z, most = points[n, 0], points[n, 1], points[n, 2], values[n]
        for m in range(planes.shape[0]):
            most = max(most, planes[m, 0] * x + planes[m, 1] * y + planes[m, 2] * z + planes[m, 3])
        values[n] = most
