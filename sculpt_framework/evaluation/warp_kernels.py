"""One camera's pixels in another image, by the depth of a mesh: the loops, for the CPU."""

import numpy as np
from numba import njit

_OPTIONS = {"error_model": "numpy", "cache": True, "nogil": True}
HIDDEN, SEEN = 1, 2


@njit(**_OPTIONS)
def project(depth, lens, rotation, shift, other, farthest, slack, places, slopes, state):
    """Where the surface at each pixel lies in the other image.

    ``depth`` (h, w) is camera z, infinite without surface. ``rotation`` and ``shift`` lead from the camera's frame to
    the other's. ``farthest`` (h', w') is the largest depth around each pixel of the other. Filled in: ``places``
    (h, w, 2), column and row of the other image counted from the middle of its first pixel; ``slopes`` (h, w, 2), what
    they change by per unit of depth; ``state``, 0 without surface, HIDDEN, or SEEN by the other camera too.
    """
    height, width = depth.shape
    for row in range(height):
        y = (row + 0.5 - lens[3]) / lens[1]
        for column in range(width):
            places[row, column, 0] = -1e4
            places[row, column, 1] = -1e4
            z = depth[row, column]
            if not np.isfinite(z):
                continue
            x = (column + 0.5 - lens[2]) / lens[0]
            wx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
            wy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
            wz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
            px, py, pz = z * wx + shift[0], z * wy + shift[1], z * wz + shift[2]
            state[row, column] = HIDDEN
            if pz <= 0:
                continue
            u, v = other[0] * px / pz + other[2], other[1] * py / pz + other[3]
            slopes[row, column, 0] = other[0] * (wx * pz - px * wz) / (pz * pz)
            slopes[row, column, 1] = other[1] * (wy * pz - py * wz) / (pz * pz)
            if u < 0 or v < 0 or u >= farthest.shape[1] or v >= farthest.shape[0]:
                continue
            places[row, column, 0] = u - 0.5
            places[row, column, 1] = v - 0.5
            if pz <= farthest[int(v), int(u)] + slack:
                state[row, column] = SEEN


@njit(**_OPTIONS)
def distances(rows, columns, flow, places, slopes, state, facing, out):
    """How far the surface is off at some pixels, across itself, from the displacement left there.

    ``facing`` (n) is by how much the surface goes away per unit of camera z: |normal . (x, y, 1)|. Filled in: ``out``
    (n, 2), from what is left along epipolar lines, and what the same length across them, which no depth explains,
    would come to. NaN where the flow leads to where there is no surface.
    """
    height, width = state.shape
    for k in range(rows.shape[0]):
        out[k] = np.nan, np.nan
        row, column = rows[k], columns[k]
        y, x = row + flow[row, column, 1], column + flow[row, column, 0]
        if not (x >= 0 and y >= 0 and x < width - 1 and y < height - 1):
            continue
        r, c = int(y), int(x)
        if min(state[r, c], state[r, c + 1], state[r + 1, c], state[r + 1, c + 1]) == 0:
            continue
        b, a = y - r, x - c
        along, across, square = 0.0, 0.0, 0.0
        for axis in range(2):
            there = (1 - b) * ((1 - a) * places[r, c, axis] + a * places[r, c + 1, axis])
            there += b * ((1 - a) * places[r + 1, c, axis] + a * places[r + 1, c + 1, axis])
            left = there - places[row, column, axis]
            slope, other = slopes[row, column, axis], slopes[row, column, 1 - axis]
            along += left * slope
            across += left * (other if axis == 1 else -other)
            square += slope * slope
        if square > 0:
            out[k] = abs(along) / square * facing[k], abs(across) / square * facing[k]
