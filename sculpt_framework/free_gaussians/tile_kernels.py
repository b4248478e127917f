"""Which Gaussians lie in which tile of an image: the loop, for the CPU."""

import numpy as np
from numba import njit

_OPTIONS = {"error_model": "numpy", "cache": True, "nogil": True}


@njit(**_OPTIONS)
def tile_lists(order, boxes, columns, rows):
    """(Gaussians of each tile, nearest first, tile by tile; where each tile's begin, and the end).

    ``boxes`` [g, 4] are the first and last tile columns and rows, the last exclusive; ``order`` is by depth.
    """
    starts = np.zeros(columns * rows + 1, np.int64)
    for g in order:
        for row in range(boxes[g, 2], boxes[g, 3]):
            for column in range(boxes[g, 0], boxes[g, 1]):
                starts[row * columns + column + 1] += 1
    for tile in range(columns * rows):
        starts[tile + 1] += starts[tile]
    lists, at = np.empty(starts[-1], np.int32), starts[:-1].copy()
    for g in order:
        for row in range(boxes[g, 2], boxes[g, 3]):
            for column in range(boxes[g, 0], boxes[g, 1]):
                tile = row * columns + column
                lists[at[tile]] = g
                at[tile] += 1
    return lists, starts
