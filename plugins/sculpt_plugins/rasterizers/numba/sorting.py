"""Depth order, and from it each tile's list of Gaussians.

One sort of all Gaussians by depth; the lists are then filled in that order and need no sorting of their own.
"""

import numpy as np
from numba import njit, prange

from .vector import prefetch_to_read

_OPTIONS = {"error_model": "numpy", "cache": True, "nogil": True}
_DIGIT = 12
"""Bits the radix sort takes at once, at most: 4096 counters stay in the first-level cache."""
_AHEAD = 16
"""Rectangles lie in mesh order and are visited in depth order: they are fetched this many ahead."""


@njit(**_OPTIONS)
def sort_by_depth(keys, keys_a, keys_b, order_a, order_b):
    """(the indices of positive keys in ascending order, stable, as a view of order_a or order_b).

    A radix sort of key - smallest key: the depths of one object need about 24 bits, which are two passes.
    """
    count = 0
    smallest, largest = np.uint32(0xFFFFFFFF), np.uint32(0)
    for i in range(keys.shape[0]):
        key = keys[i]
        if key != 0:
            keys_a[count] = key
            order_a[count] = i
            count += 1
            smallest, largest = min(smallest, key), max(largest, key)
    if count == 0:
        return order_a[:0]
    bits = 0
    while np.uint64(largest - smallest) >> np.uint64(bits) != 0:
        bits += 1
    passes = max(1, (bits + _DIGIT - 1) // _DIGIT)
    width = np.uint32((bits + passes - 1) // passes)
    mask = np.uint32((1 << width) - 1)
    starts = np.empty(1 << width, np.int32)
    for index in range(passes):
        shift = np.uint32(index) * width
        starts[:] = 0
        for i in range(count):
            starts[((keys_a[i] - smallest) >> shift) & mask] += 1
        total = 0
        for digit in range(starts.shape[0]):
            here = starts[digit]
            starts[digit] = total
            total += here
        for i in range(count):
            key = keys_a[i]
            digit = ((key - smallest) >> shift) & mask
            position = starts[digit]
            starts[digit] = position + 1
            keys_b[position] = key
            order_b[position] = order_a[i]
        keys_a, keys_b = keys_b, keys_a
        order_a, order_b = order_b, order_a
    return order_a[:count]


@njit(parallel=True, **_OPTIONS)
def count_tiles(order, tiles, columns, counts):
    """counts[part, tile]: Gaussians that stretch ``part`` of the depth order puts into each tile."""
    parts = counts.shape[0]
    flat_tiles = tiles.reshape(tiles.size)
    for part in prange(parts):
        first, end = order.shape[0] * part // parts, order.shape[0] * (part + 1) // parts
        here = counts[part]
        here[:] = 0
        for s in range(first, end):
            prefetch_to_read(flat_tiles, np.int64(order[min(s + _AHEAD, end - 1)]) * 4)
            i = order[s]
            for row in range(tiles[i, 2], tiles[i, 3] + 1):
                for column in range(tiles[i, 0], tiles[i, 1] + 1):
                    here[row * columns + column] += 1


@njit(**_OPTIONS)
def place_tiles(counts, starts):
    """Turn counts into positions in one array of all lists; starts[tile] is a list's beginning. Returns its length."""
    parts, tiles = counts.shape
    total = 0
    for tile in range(tiles):
        starts[tile] = total
        for part in range(parts):
            here = counts[part, tile]
            counts[part, tile] = total
            total += here
    starts[tiles] = total
    return total


@njit(parallel=True, **_OPTIONS)
def fill_tiles(order, tiles, columns, positions, lists):
    """Write the lists; every stretch of the depth order knows its positions, so that the lists stay sorted."""
    parts = positions.shape[0]
    flat_tiles = tiles.reshape(tiles.size)
    for part in prange(parts):
        first, end = order.shape[0] * part // parts, order.shape[0] * (part + 1) // parts
        here = positions[part]
        for s in range(first, end):
            prefetch_to_read(flat_tiles, np.int64(order[min(s + _AHEAD, end - 1)]) * 4)
            i = order[s]
            for row in range(tiles[i, 2], tiles[i, 3] + 1):
                for column in range(tiles[i, 0], tiles[i, 1] + 1):
                    position = here[row * columns + column]
                    here[row * columns + column] = position + 1
                    lists[position] = i
