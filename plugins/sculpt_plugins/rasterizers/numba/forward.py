"""Compositing, front to back, tile by tile."""

import numpy as np
from numba import njit, prange

from .layout import (
    ALPHA_MIN,
    BLOCK,
    CURVE,
    DEPTH,
    FEATURES,
    LANES,
    LEVEL,
    MEAN_X,
    MEAN_Y,
    PIXELS,
    SLANT,
    STEEP,
    TILE,
    TRANSMITTANCE_MIN,
)
from .vector import (
    copies,
    fetch_add,
    lane_column,
    lane_row,
    lanes_at_least,
    larger,
    load,
    lowest_bit,
    magnitude,
    mark_lanes,
    marked_lanes,
    prefetch_to_read,
    smaller,
    store,
    where_at_least,
)

OPTIONS = {"fastmath": True, "error_model": "numpy", "cache": True, "nogil": True}
AHEAD = 16
"""Records lie in mesh order and are visited in depth order: they are fetched this many ahead."""
TILES_AT_ONCE = 4
"""Tiles a thread takes from the queue at a time."""
BATCH = 32
"""Gaussians of a tile's list that are worked on at a time: as many as a word of marks has bits."""
_IN_REGISTERS = 3
"""Features whose sums stay in registers while a block's Gaussians pass; further ones are kept in memory."""
ALL_BLOCKS = (1 << LANES) - 1

_ZERO, _ONE, _HALF, _MINUS_ONE = np.float32(0), np.float32(1), np.float32(0.5), np.float32(-1)
_TINY = np.float32(1e-12)
_BLOCK = np.float32(BLOCK)
_BLOCK_HALF = np.float32((BLOCK - 1) / 2)


def _exponential_coefficients():
    """Chebyshev fit of 2^y on [-1, 0], relative error 1e-7."""
    y = np.cos(np.pi * (np.arange(400) + 0.5) / 400) * 0.5 - 0.5
    return [np.float32(c) for c in np.polynomial.polynomial.polyfit(y, 2.0**y, 5, w=2.0**-y)]


_E0, _E1, _E2, _E3, _E4, _E5 = _exponential_coefficients()


@njit(forceinline=True)
def power_of_256(y):
    """2^(8 y) for y in [-1, 0]; below, that of -1, which is less than any alpha that counts.

    The eighth power of a short polynomial: alpha >= 1/255 leaves no larger range, and no exponent bits are needed.
    """
    y = larger(y, _MINUS_ONE)
    p = _E0 + y * (_E1 + y * (_E2 + y * (_E3 + y * (_E4 + y * _E5))))
    p = p * p
    p = p * p
    return p * p


@njit(forceinline=True)
def pixel_index(row, column):
    """Where a tile's pixel is kept: block by block."""
    block = (row // BLOCK) * (TILE // BLOCK) + column // BLOCK
    return block * LANES + (row % BLOCK) * BLOCK + column % BLOCK


@njit(forceinline=True)
def _exponents_at_most(records, r, origin_x, origin_y):
    """A bound of the exponent in each block of the tile; a lane is a block here.

    It is level + curve dx^2 - u^2 with the least |dx| and the least |u| in the block, each on its own.
    """
    dx = lane_column() * _BLOCK + (_BLOCK_HALF - (records[r + MEAN_X] - origin_x))
    dy = lane_row() * _BLOCK + (_BLOCK_HALF - (records[r + MEAN_Y] - origin_y))
    slant, steep = records[r + SLANT], records[r + STEEP]
    u = larger(magnitude(slant * dx + steep * dy) - _BLOCK_HALF * (abs(slant) + steep), _ZERO)
    dx = larger(magnitude(dx) - _BLOCK_HALF, _ZERO)
    return records[r + LEVEL] + records[r + CURVE] * dx * dx - u * u


@njit(parallel=True, **OPTIONS)
def composite(
    records, stride, lists, blocks, starts, width, height, threads, background, background_step, alpha_max,
    image, alpha, depth, kept, seen, queue,
):  # fmt: skip
    """Fill image, alpha and depth, and leave for the backward pass what contributed where.

    Each tile's list is shortened to its ``kept`` first entries, whose bits in ``blocks`` say in which blocks; ``seen``
    (one element longer than there are Gaussians) marks them. ``records`` and ``background`` are flat, with ``stride``
    and ``background_step`` floats per record and pixel (0: one colour).

    A batch of the list is first sorted into the tile's blocks; then each block's pixels stay in registers while its
    Gaussians pass.
    """
    tiles = starts.shape[0] - 1
    columns = (width + TILE - 1) // TILE
    channels = image.shape[2]
    for _ in prange(threads):
        # Transmittance, depth and features of the tile's pixels.
        state = np.empty(PIXELS * (2 + max(channels, _IN_REGISTERS)), np.float32)
        # The batch: who, their records, and for each block one bit per Gaussian: may reach it, has contributed to it.
        who = np.empty(BATCH, np.int32)
        local = np.empty(BATCH * stride, np.float32)
        reach = np.empty(LANES, np.uint32)
        hits = np.empty(LANES, np.uint32)
        while True:
            first_tile = fetch_add(queue, 0, TILES_AT_ONCE)
            if first_tile >= tiles:
                break
            for tile in range(first_tile, min(first_tile + TILES_AT_ONCE, tiles)):
                top, left = (tile // columns) * TILE, (tile % columns) * TILE
                origin_x, origin_y = np.float32(left) + _HALF, np.float32(top) + _HALF
                state[:PIXELS] = _ONE
                state[PIXELS:] = _ZERO
                begin, end = starts[tile], starts[tile + 1]
                position = keep = begin
                is_open = ALL_BLOCKS
                while position < end and is_open != 0:
                    reach[:] = 0
                    hits[:] = 0
                    count = 0
                    stop = min(position + BATCH, end)
                    while position < stop:
                        gaussian = lists[position]
                        prefetch_to_read(records, np.int64(lists[min(position + AHEAD, end - 1)]) * stride)
                        position += 1
                        r = np.int64(gaussian) * stride
                        bound = _exponents_at_most(records, r, origin_x, origin_y)
                        touched = mark_lanes(reach, bound, _MINUS_ONE, np.uint32(1) << np.uint32(count))
                        at = count * stride
                        for first in range(0, stride, LANES):
                            store(local, at + first, load(records, r + first))
                        local[at + MEAN_X] = records[r + MEAN_X] - origin_x
                        local[at + MEAN_Y] = records[r + MEAN_Y] - origin_y
                        who[count] = gaussian
                        count += int(touched & is_open != 0)
                        # A Gaussian that is dropped leaves its bit behind in closed blocks only.
                    for block in range(LANES):
                        members = np.int64(reach[block])
                        if members == 0 or (is_open >> block) & 1 == 0:
                            continue
                        i = block * LANES
                        transmittance, total_depth = load(state, i), load(state, PIXELS + i)
                        total_0, total_1 = load(state, PIXELS * 2 + i), load(state, PIXELS * 3 + i)
                        total_2 = load(state, PIXELS * 4 + i)
                        column = lane_column() + np.float32((block % 4) * BLOCK)
                        row = lane_row() + np.float32((block // 4) * BLOCK)
                        contributed = 0
                        while members != 0:
                            entry = lowest_bit(members)
                            members &= members - 1
                            at = entry * stride
                            dx, dy = column - copies(local, at + MEAN_X), row - copies(local, at + MEAN_Y)
                            u = copies(local, at + SLANT) * dx + copies(local, at + STEEP) * dy
                            exponent = copies(local, at + LEVEL) + copies(local, at + CURVE) * dx * dx - u * u
                            p = smaller(power_of_256(exponent), alpha_max)
                            weight = where_at_least(p, ALPHA_MIN, p * transmittance, _ZERO)
                            weight = where_at_least(transmittance, TRANSMITTANCE_MIN, weight, _ZERO)
                            contributed |= int(lanes_at_least(weight, _TINY) != 0) << entry
                            transmittance = transmittance - weight
                            total_depth += weight * copies(local, at + DEPTH)
                            total_0 += weight * copies(local, at + FEATURES)
                            if channels > 1:
                                total_1 += weight * copies(local, at + FEATURES + 1)
                            if channels > 2:
                                total_2 += weight * copies(local, at + FEATURES + 2)
                            for c in range(_IN_REGISTERS, channels):
                                j = PIXELS * (2 + c) + i
                                store(state, j, load(state, j) + weight * copies(local, at + FEATURES + c))
                            if lanes_at_least(transmittance, TRANSMITTANCE_MIN) == 0:
                                is_open &= ~(1 << block)
                                break
                        hits[block] = contributed
                        store(state, i, transmittance)
                        store(state, PIXELS + i, total_depth)
                        store(state, PIXELS * 2 + i, total_0)
                        store(state, PIXELS * 3 + i, total_1)
                        store(state, PIXELS * 4 + i, total_2)
                    for entry in range(count):
                        hit = marked_lanes(hits, np.uint32(1) << np.uint32(entry))
                        lists[keep] = who[entry]
                        blocks[keep] = hit
                        keep += int(hit != 0)
                        seen[who[entry] if hit != 0 else seen.shape[0] - 1] = 1
                kept[tile] = keep - begin
                for row in range(min(TILE, height - top)):
                    for column in range(min(TILE, width - left)):
                        i = pixel_index(row, column)
                        y, x = top + row, left + column
                        transmittance = state[i]
                        behind = (y * width + x) * background_step
                        for c in range(channels):
                            image[y, x, c] = state[PIXELS * (2 + c) + i] + transmittance * background[behind + c]
                        alpha[y, x] = _ONE - transmittance
                        depth[y, x] = state[PIXELS + i]
