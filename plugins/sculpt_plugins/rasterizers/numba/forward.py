"""Compositing, front to back, tile by tile."""

import numpy as np
from numba import njit, prange

from .layout import (
    ALPHA_MIN,
    BLOCK_ROWS,
    BLOCKS,
    CURVE,
    DEPTH,
    FEATURES,
    LANES,
    LEVEL,
    MEAN_X,
    MEAN_Y,
    PIXELS,
    ROWS,
    SLANT,
    STEEP,
    TILE_HEIGHT,
    TILE_WIDTH,
    TRANSMITTANCE_MIN,
)
from .vector import (
    any_at_least,
    fetch_add,
    lane_column,
    lane_row,
    larger,
    load,
    prefetch_to_read,
    smaller,
    store,
    where_at_least,
)

OPTIONS = {"fastmath": True, "error_model": "numpy", "cache": True, "nogil": True}
TILES_AT_ONCE = 4
"""Tiles a thread takes from the queue at a time."""
AHEAD = 6
"""Records lie in mesh order and are visited in depth order: they are fetched this many ahead."""
ALL_OPEN = (1 << BLOCKS) - 1

_ZERO, _ONE, _HALF, _MINUS_ONE = np.float32(0), np.float32(1), np.float32(0.5), np.float32(-1)
_TINY = np.float32(1e-12)


def _exponential_coefficients():
    """Chebyshev fit of 2^y on [-1, 0], relative error 1e-7."""
    y = np.cos(np.pi * (np.arange(400) + 0.5) / 400) * 0.5 - 0.5
    return [np.float32(c) for c in np.polynomial.polynomial.polyfit(y, 2.0**y, 5, w=2.0**-y)]


_E0, _E1, _E2, _E3, _E4, _E5 = _exponential_coefficients()


@njit(inline="always")
def power_of_256(y):
    """2^(8 y) for y in [-1, 0]; below, that of -1, which is less than any alpha that counts.

    The eighth power of a short polynomial: alpha >= 1/255 leaves no larger range, and no exponent bits are needed.
    """
    y = larger(y, _MINUS_ONE)
    p = _E0 + y * (_E1 + y * (_E2 + y * (_E3 + y * (_E4 + y * _E5))))
    p = p * p
    p = p * p
    return p * p


@njit(parallel=True, **OPTIONS)
def composite(
    records, bits, lists, starts, width, height, threads, background, background_step, alpha_max,
    image, alpha, depth, kept, seen, queue,
):  # fmt: skip
    """Fill image, alpha and depth; shorten each tile's list to what contributed (``kept`` entries) and mark it seen.

    ``records`` and ``bits`` are flat views. ``background`` is flat, ``background_step`` floats per pixel (0: one
    colour). ``seen`` has one element more than there are Gaussians, for what nobody asks about.
    """
    tiles = starts.shape[0] - 1
    columns = (width + TILE_WIDTH - 1) // TILE_WIDTH
    channels = image.shape[2]
    gaussians = seen.shape[0] - 1
    stride = records.shape[0] // max(gaussians, 1)
    for _ in prange(threads):
        # Transmittance, depth and features of the tile's pixels.
        state = np.empty(PIXELS * (channels + 2), np.float32)
        while True:
            first_tile = fetch_add(queue, 0, TILES_AT_ONCE)
            if first_tile >= tiles:
                break
            for tile in range(first_tile, min(first_tile + TILES_AT_ONCE, tiles)):
                top, left = (tile // columns) * TILE_HEIGHT, (tile % columns) * TILE_WIDTH
                state[:PIXELS] = _ONE
                state[PIXELS:] = _ZERO
                origin_x, origin_y = np.float32(left) + _HALF, np.float32(top) + _HALF
                begin, end = starts[tile], starts[tile + 1]
                position = keep = begin
                is_open = ALL_OPEN
                while position < end and is_open != 0:
                    gaussian = np.int64(lists[position])
                    r = gaussian * stride
                    prefetch_to_read(records, np.int64(lists[min(position + AHEAD, end - 1)]) * stride)
                    position += 1
                    rows = bits[r + ROWS]
                    first_block = max((rows & 0xFFFF) - top, 0) // BLOCK_ROWS
                    last_block = min((rows >> 16) - top, TILE_HEIGHT - 1) // BLOCK_ROWS
                    mean_y = records[r + MEAN_Y] - origin_y
                    steep = records[r + STEEP]
                    gaussian_depth = records[r + DEPTH]
                    dx = lane_column() - (records[r + MEAN_X] - origin_x)
                    level = records[r + LEVEL] + records[r + CURVE] * dx * dx
                    slanted = records[r + SLANT] * dx
                    hit = 0
                    for block in range(first_block, last_block + 1):
                        if (is_open >> block) & 1:
                            dy = lane_row() + (np.float32(block * BLOCK_ROWS) - mean_y)
                            u = slanted + steep * dy
                            p = smaller(power_of_256(level - u * u), alpha_max)
                            i = block * LANES
                            transmittance = load(state, i)
                            weight = p * transmittance
                            weight = where_at_least(p, ALPHA_MIN, weight, _ZERO)
                            weight = where_at_least(transmittance, TRANSMITTANCE_MIN, weight, _ZERO)
                            hit |= int(any_at_least(weight, _TINY))
                            transmittance = transmittance - weight
                            store(state, i, transmittance)
                            store(state, PIXELS + i, load(state, PIXELS + i) + weight * gaussian_depth)
                            for c in range(channels):
                                j = PIXELS * (2 + c) + i
                                store(state, j, load(state, j) + weight * records[r + FEATURES + c])
                            is_open &= ~(int(not any_at_least(transmittance, TRANSMITTANCE_MIN)) << block)
                    lists[keep] = gaussian
                    keep += hit
                    seen[gaussian if hit else gaussians] = 1
                kept[tile] = keep - begin
                for row in range(min(TILE_HEIGHT, height - top)):
                    for column in range(min(TILE_WIDTH, width - left)):
                        i = row * TILE_WIDTH + column
                        y, x = top + row, left + column
                        transmittance = state[i]
                        behind = (y * width + x) * background_step
                        for c in range(channels):
                            image[y, x, c] = state[PIXELS * (2 + c) + i] + transmittance * background[behind + c]
                        alpha[y, x] = _ONE - transmittance
                        depth[y, x] = state[PIXELS + i]
