"""Truncated distances of depth maps: the loops, for the CPU."""

import numpy as np
from numba import njit, prange

_OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy", "cache": True, "nogil": True}
_ONE = np.float32(1)


@njit(parallel=True, **_OPTIONS)
def add_view(low, cell, pose, lens, depth, covered, truncation, sums, counts, shown):
    """Add what a view says of the corners ``low`` + ``cell`` (i, j, k) to ``sums`` and ``counts`` [x, y, z].

    ``depth`` is camera z, read where ``covered``; elsewhere the view sees that nothing is there. ``shown`` becomes true
    of what lies in the image, also behind what it sees.
    """
    height, width = depth.shape
    for i in prange(sums.shape[0]):
        for j in range(sums.shape[1]):
            for k in range(sums.shape[2]):
                x, y, z = low[0] + cell * i, low[1] + cell * j, low[2] + cell * k
                far = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
                if not far > np.float32(1e-4):
                    continue
                across = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
                down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
                u, v = across / far * lens[0] + lens[2], down / far * lens[1] + lens[3]
                if not (u >= 0 and v >= 0 and u < width and v < height):
                    continue
                shown[i, j, k] = True
                row, column = np.int32(v), np.int32(u)
                if not covered[row, column]:
                    sums[i, j, k] += _ONE
                    counts[i, j, k] += _ONE
                    continue
                ahead = depth[row, column] - far
                if ahead > -truncation:
                    sums[i, j, k] += min(ahead / truncation, _ONE)
                    counts[i, j, k] += _ONE
