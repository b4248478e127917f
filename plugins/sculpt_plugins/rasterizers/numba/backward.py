"""Gradients of compositing: per Gaussian, sums over the pixels it contributed to.

The image is cut into bands of tile rows. Each Gaussian that was seen owns one row of sums per band it reaches
(nearly always one), so that bands can be worked on in any order by any thread and nothing is added up by two at once.
"""

import numpy as np
from numba import njit, prange

from .forward import AHEAD, OPTIONS, pixel_index, power_of_256
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
    SLOT,
    STEEP,
    SUM_FEATURES,
    TILE,
    TRANSMITTANCE_MIN,
)
from .vector import (
    add_sums_of_8,
    copies,
    fetch_add,
    lane_column,
    lane_row,
    load,
    lowest_bit,
    prefetch_to_read,
    prefetch_to_write,
    smaller,
    splat,
    store,
    where_at_least,
)

_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_IN_FIRST_PASS = 6
"""Features whose sums are kept in registers while the geometry's are formed; further ones take another pass."""


@njit(parallel=True, **OPTIONS)
def count_slots(seen, tiles, band_rows, part_counts):
    """part_counts[p]: rows of sums that the Gaussians of stretch p need."""
    parts = part_counts.shape[0]
    count = tiles.shape[0]
    for part in prange(parts):
        total = 0
        for i in range(count * part // parts, count * (part + 1) // parts):
            if seen[i] != 0:
                total += tiles[i, 3] // band_rows - tiles[i, 2] // band_rows + 1
        part_counts[part] = total


@njit(parallel=True, **OPTIONS)
def assign_slots(seen, tiles, band_rows, part_starts, first_slot, bits, stride, sums, sums_stride):
    """Number the rows of sums, tell each record where its own begin, and clear them. ``bits`` and ``sums`` are flat."""
    parts = part_starts.shape[0] - 1
    count = tiles.shape[0]
    for part in prange(parts):
        slot = part_starts[part]
        for i in range(count * part // parts, count * (part + 1) // parts):
            first_slot[i] = slot
            if seen[i] != 0:
                first_band = tiles[i, 2] // band_rows
                bits[np.int64(i) * stride + SLOT] = slot - first_band
                slot += tiles[i, 3] // band_rows - first_band + 1
        sums[part_starts[part] * sums_stride : part_starts[part + 1] * sums_stride] = _ZERO
    first_slot[count] = part_starts[parts]


@njit(parallel=True, **OPTIONS)
def composite_backward(
    records, bits, stride, lists, blocks, starts, kept, width, height, threads, band_rows, alpha_max,
    image, alpha, depth, to_image, to_alpha, to_depth, with_depth, with_shape, sums, sums_stride, queue,
):  # fmt: skip
    """Add each contribution to its Gaussian's row of ``sums`` (see layout.py).

    Without ``with_shape`` only the features' sums are formed: colours alone are learned.

    Front to back once more, with the same decisions as before. Of what lies behind a contribution only one number per
    pixel is needed: the rest of sum_i w_i (g . f_i), background included, which starts as g . image.
    """
    columns, tile_rows = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    bands = (tile_rows + band_rows - 1) // band_rows
    channels = image.shape[2]
    for _ in prange(threads):
        # Transmittance, the rest, the gradients by depth and features, and the weights of the last Gaussian.
        padded = _IN_FIRST_PASS + (max(channels - _IN_FIRST_PASS, 0) + 7) // 8 * 8
        state = np.zeros(PIXELS * (3 + padded), np.float32)
        weights = np.zeros(PIXELS, np.float32)
        while True:
            band = fetch_add(queue, 0, 1)
            if band >= bands:
                break
            for tile in range(band * band_rows * columns, min((band + 1) * band_rows, tile_rows) * columns):
                entries = kept[tile]
                if entries == 0:
                    continue
                top, left = (tile // columns) * TILE, (tile % columns) * TILE
                origin_x, origin_y = np.float32(left) + _HALF, np.float32(top) + _HALF
                tile_width, tile_height = min(TILE, width - left), min(TILE, height - top)
                if tile_width < TILE or tile_height < TILE:
                    state[:] = _ZERO
                for row in range(tile_height):
                    for column in range(tile_width):
                        i = pixel_index(row, column)
                        y, x = top + row, left + column
                        state[i] = _ONE
                        rest = -to_alpha[y, x] * (_ONE - alpha[y, x])
                        if with_depth:
                            state[PIXELS * 2 + i] = to_depth[y, x]
                            rest += to_depth[y, x] * depth[y, x]
                        for c in range(channels):
                            state[PIXELS * (3 + c) + i] = to_image[y, x, c]
                        state[PIXELS + i] = rest + _in_order(to_image, image, y, x)
                begin = starts[tile]
                for position in range(begin, begin + entries):
                    r = np.int64(lists[position]) * stride
                    ahead = np.int64(lists[min(position + AHEAD, begin + entries - 1)]) * stride
                    prefetch_to_read(records, ahead)
                    near = np.int64(lists[min(position + AHEAD // 2, begin + entries - 1)]) * stride
                    prefetch_to_write(sums, np.int64(bits[near + SLOT] + band) * sums_stride)
                    slot = np.int64(bits[r + SLOT] + band) * sums_stride
                    mean_x, mean_y = records[r + MEAN_X] - origin_x, records[r + MEAN_Y] - origin_y
                    slant, steep = copies(records, r + SLANT), copies(records, r + STEEP)
                    curve, level = copies(records, r + CURVE), copies(records, r + LEVEL)
                    sum_x, sum_u, sum_xx, sum_xu = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
                    sum_uu, sum_one, sum_depth = splat(_ZERO), splat(_ZERO), splat(_ZERO)
                    sum_0, sum_1, sum_2 = splat(_ZERO), splat(_ZERO), splat(_ZERO)
                    sum_3, sum_4, sum_5 = splat(_ZERO), splat(_ZERO), splat(_ZERO)
                    mask = np.int64(blocks[position])
                    while mask != 0:
                        block = lowest_bit(mask)
                        mask &= mask - 1
                        i = block * LANES
                        dx = lane_column() + (np.float32((block % 4) * BLOCK) - mean_x)
                        dy = lane_row() + (np.float32((block // 4) * BLOCK) - mean_y)
                        u = slant * dx + steep * dy
                        free = power_of_256(level + curve * dx * dx - u * u)
                        p = smaller(free, alpha_max)
                        transmittance = load(state, i)
                        p = where_at_least(p, ALPHA_MIN, p, _ZERO)
                        p = where_at_least(transmittance, TRANSMITTANCE_MIN, p, _ZERO)
                        weight = p * transmittance
                        store(state, i, transmittance - weight)
                        own = splat(_ZERO)
                        if with_depth:
                            gradient = load(state, PIXELS * 2 + i)
                            own = gradient * copies(records, r + DEPTH)
                            sum_depth += weight * gradient
                        gradient = load(state, PIXELS * 3 + i)
                        own += gradient * copies(records, r + FEATURES)
                        sum_0 += weight * gradient
                        if channels > 1:
                            gradient = load(state, PIXELS * 4 + i)
                            own += gradient * copies(records, r + FEATURES + 1)
                            sum_1 += weight * gradient
                        if channels > 2:
                            gradient = load(state, PIXELS * 5 + i)
                            own += gradient * copies(records, r + FEATURES + 2)
                            sum_2 += weight * gradient
                        if channels > 3:
                            gradient = load(state, PIXELS * 6 + i)
                            own += gradient * copies(records, r + FEATURES + 3)
                            sum_3 += weight * gradient
                        if channels > 4:
                            gradient = load(state, PIXELS * 7 + i)
                            own += gradient * copies(records, r + FEATURES + 4)
                            sum_4 += weight * gradient
                        if channels > 5:
                            gradient = load(state, PIXELS * 8 + i)
                            own += gradient * copies(records, r + FEATURES + 5)
                            sum_5 += weight * gradient
                        if channels > _IN_FIRST_PASS:
                            for c in range(_IN_FIRST_PASS, channels):
                                own += load(state, PIXELS * (3 + c) + i) * copies(records, r + FEATURES + c)
                            store(weights, i, weight)
                        if with_shape:
                            own = weight * own
                            rest = load(state, PIXELS + i) - own
                            store(state, PIXELS + i, rest)
                            s = own - rest * p / (_ONE - p)
                            # At the ceiling alpha no longer depends on the Gaussian's shape and opacity.
                            s = where_at_least(alpha_max, free, s, _ZERO)
                            sum_one += s
                            sx, su = s * dx, s * u
                            sum_x += sx
                            sum_u += su
                            sum_xx += sx * dx
                            sum_xu += sx * u
                            sum_uu += su * u
                    add_sums_of_8(sums, slot, sum_x, sum_u, sum_xx, sum_xu, sum_uu, sum_one, sum_depth, sum_0)
                    if channels > 1:
                        none = splat(_ZERO)
                        add_sums_of_8(sums, slot + 8, sum_1, sum_2, sum_3, sum_4, sum_5, none, none, none)
                    for first in range(_IN_FIRST_PASS, channels, 8):
                        _add_features(
                            sums, slot + SUM_FEATURES + first, state, PIXELS * (3 + first), weights, blocks[position]
                        )


@njit(error_model="numpy")
def _in_order(gradients, image, y, x):
    """The sum over a pixel's channels of gradient times value, first to last: left to the compiler, its order depends
    on where in memory the images lie, and runs are no longer the same to the bit."""
    total = np.float32(0)
    for c in range(image.shape[2]):
        total += gradients[y, x, c] * image[y, x, c]
    return total


@njit(fastmath=True, error_model="numpy")
def _add_features(sums, index, state, gradients, weights, mask):
    """The sums of eight more features, from the weights that the first pass has left behind."""
    sum_0, sum_1, sum_2, sum_3 = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
    sum_4, sum_5, sum_6, sum_7 = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
    mask = np.int64(mask)
    while mask != 0:
        block = lowest_bit(mask)
        mask &= mask - 1
        weight = load(weights, block * LANES)
        i = gradients + block * LANES
        sum_0 += weight * load(state, i)
        sum_1 += weight * load(state, i + PIXELS)
        sum_2 += weight * load(state, i + PIXELS * 2)
        sum_3 += weight * load(state, i + PIXELS * 3)
        sum_4 += weight * load(state, i + PIXELS * 4)
        sum_5 += weight * load(state, i + PIXELS * 5)
        sum_6 += weight * load(state, i + PIXELS * 6)
        sum_7 += weight * load(state, i + PIXELS * 7)
    add_sums_of_8(sums, index, sum_0, sum_1, sum_2, sum_3, sum_4, sum_5, sum_6, sum_7)
