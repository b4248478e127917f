"""From depth maps to a volume: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

# No "nnan" and "ninf": unknown depths are 0, but what a user's volume holds may be anything.
_OPTIONS = {"fastmath": {"nsz", "contract", "reassoc", "arcp"}, "error_model": "numpy", "cache": True, "nogil": True}
_ONE, _HALF, _ZERO, _TWO = np.float32(1), np.float32(0.5), np.float32(0), np.float32(2)
_NEAR = np.float32(1e-4)
_BINS = 9
"""Of distances, in which the views' words are counted."""


@njit(forceinline=True, **_OPTIONS)
def _depth_at(depths, normals, weights, lenses, view, u, v, jump):
    """(depth, weight, cosine) at (u, v), in pixels from the middle of the first: interpolated where the four around are
    of one surface, that of the nearest pixel where they are not. Depth 0 where none is known, or outside of the image.

    The cosine is how fast the distance to the surface grows with the difference in depth.
    """
    height, width = depths.shape[1], depths.shape[2]
    if not (u >= 0 and v >= 0 and u < np.float32(width - 1) and v < np.float32(height - 1)):
        return _ZERO, _ZERO, _ZERO
    column, row = np.int32(u), np.int32(v)
    right, below = u - np.float32(column), v - np.float32(row)
    lowest, highest, total, share = np.float32(np.inf), _ZERO, _ZERO, _ZERO
    for a in range(2):
        for b in range(2):
            depth = depths[view, row + a, column + b]
            if depth > 0:
                part = (below if a == 1 else _ONE - below) * (right if b == 1 else _ONE - right)
                total += part * depth
                share += part
                lowest, highest = min(lowest, depth), max(highest, depth)
    row, column = np.int32(v + _HALF), np.int32(u + _HALF)
    depth, weight = depths[view, row, column], weights[view, row, column]
    if not depth > 0:
        return _ZERO, _ZERO, _ZERO
    if highest - lowest < jump:
        depth = total / share
    x = (u + _HALF - lenses[view, 2]) / lenses[view, 0]
    y = (v + _HALF - lenses[view, 3]) / lenses[view, 1]
    normal = normals[view, row, column]
    return depth, weight, abs(normal[0] * x + normal[1] * y + normal[2])


@njit(forceinline=True, **_OPTIONS)
def _projected(poses, lenses, view, x, y, z):
    """Depth, column and row of a point; the last two mean nothing where it is not in front of the camera."""
    far = poses[view, 2, 0] * x + poses[view, 2, 1] * y + poses[view, 2, 2] * z + poses[view, 2, 3]
    right = poses[view, 0, 0] * x + poses[view, 0, 1] * y + poses[view, 0, 2] * z + poses[view, 0, 3]
    down = poses[view, 1, 0] * x + poses[view, 1, 1] * y + poses[view, 1, 2] * z + poses[view, 1, 3]
    return far, lenses[view, 0] * right / far + lenses[view, 2], lenses[view, 1] * down / far + lenses[view, 3]


@njit(parallel=True, **_OPTIONS)
def vote(points, wanted, depths, normals, weights, poses, lenses, front, back, values, sureness):
    """Per ``wanted`` point, how far it lies in front of what the views see, in units of ``front`` and cut at 1, and the
    weight of the views that say so. A view says nothing of what lies more than ``back`` behind what it sees.

    The value is the mean of the words around their weighted median: of two camps the larger counts, not a compromise.
    """
    bins = np.int32(_BINS)
    scale = np.float32(bins - 1) / (front + back)
    for n in prange(points.shape[0]):
        sureness[n] = _ZERO
        if not wanted[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        weight_in, sum_in = np.zeros(_BINS, np.float32), np.zeros(_BINS, np.float32)
        total = _ZERO
        for i in range(depths.shape[0]):
            far, u, v = _projected(poses, lenses, i, x, y, z)
            if not far > _NEAR:
                continue
            u, v = u - _HALF, v - _HALF
            depth, weight, cosine = _depth_at(depths, normals, weights, lenses, i, u, v, front)
            ahead = (depth - far) * cosine
            if not (depth > 0 and ahead >= -back):
                continue
            ahead = min(ahead, front)
            place = np.int32((ahead + back) * scale + _HALF)
            weight_in[place] += weight
            sum_in[place] += weight * ahead
            total += weight
        if not total > 0:
            continue
        half, middle = _ZERO, 0
        for k in range(_BINS):
            half += weight_in[k]
            if half >= _HALF * total:
                middle = k
                break
        weight, mean = _ZERO, _ZERO
        for k in range(max(middle - 1, 0), min(middle + 2, _BINS)):
            weight += weight_in[k]
            mean += sum_in[k]
        values[n] = mean / weight / front
        sureness[n] = weight


@njit(parallel=True, **_OPTIONS)
def count_sights(points, wanted, depths, poses, lenses, sizes, before, behind, hidden, through, shown):
    """Per ``wanted`` point, in how many images it lies, in how many of them something is seen more than ``before`` in
    front of it, and in how many more than ``behind`` behind it."""
    for n in prange(points.shape[0]):
        hidden[n], through[n], shown[n] = 0, 0, 0
        if not wanted[n]:
            continue
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for i in range(depths.shape[0]):
            far, u, v = _projected(poses, lenses, i, x, y, z)
            if not (far > _NEAR and u >= 0 and v >= 0 and u < np.float32(sizes[i, 1]) and v < np.float32(sizes[i, 0])):
                continue
            depth = depths[i, np.int32(v), np.int32(u)]
            shown[n] += 1
            hidden[n] += depth > 0 and depth < far - before
            through[n] += depth > far + behind


@njit(parallel=True, **_OPTIONS)
def dual_step(ahead, flow, step, soft):
    """Gradient ascent of the flow [x, y, z, 3] along the slopes of ``ahead`` [x, y, z], kept within unit length."""
    nx, ny, nz = ahead.shape
    shrink = _ONE / (_ONE + step * soft)
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                here = ahead[i, j, k]
                a = flow[i, j, k, 0] + step * (ahead[i + 1, j, k] - here if i + 1 < nx else _ZERO)
                b = flow[i, j, k, 1] + step * (ahead[i, j + 1, k] - here if j + 1 < ny else _ZERO)
                c = flow[i, j, k, 2] + step * (ahead[i, j, k + 1] - here if k + 1 < nz else _ZERO)
                a, b, c = a * shrink, b * shrink, c * shrink
                over = max(_ONE, np.sqrt(a * a + b * b + c * c))
                flow[i, j, k, 0], flow[i, j, k, 1], flow[i, j, k, 2] = a / over, b / over, c / over


@njit(parallel=True, **_OPTIONS)
def primal_step(values, ahead, flow, wanted, weights, least, step, soft):
    """Gradient descent of ``values`` along the divergence of the flow, then towards what is ``wanted`` by its weights,
    never below ``least``; ``ahead`` becomes the extrapolation that the next dual step takes. A difference to what is
    wanted counts by its square up to ``soft``, linearly beyond."""
    nx, ny, nz = values.shape
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                divergence = flow[i, j, k, 0] + flow[i, j, k, 1] + flow[i, j, k, 2]
                if i > 0:
                    divergence -= flow[i - 1, j, k, 0]
                if j > 0:
                    divergence -= flow[i, j - 1, k, 1]
                if k > 0:
                    divergence -= flow[i, j, k - 1, 2]
                before = values[i, j, k]
                away, pull = before + step * divergence - wanted[i, j, k], step * weights[i, j, k]
                if abs(away) <= soft + pull:
                    away *= soft / (soft + pull)
                else:
                    away -= pull if away > 0 else -pull
                value = max(wanted[i, j, k] + away, least[i, j, k])
                ahead[i, j, k] = _TWO * value - before
                values[i, j, k] = value
