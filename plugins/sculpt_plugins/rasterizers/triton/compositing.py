"""Compositing, front to back, and its gradients: one program per tile.

A tile is 8 x 8 pixels and belongs to a single warp, two pixels to a lane. Gaussians on faces are small, often under a
pixel beside the low-pass filter. A million of them on a sphere in 800 x 800 pixels cover 23 pixels each and reach 2.3
such tiles, 150 pairs of a pixel and a splat; with tiles of 16 x 16 it would be 1.6 tiles and 410 pairs, nearly all of
which add nothing. Nothing is shared between warps, so that no barrier is waited for, and a tile that is saturated makes
room for the next one at once.

The list is worked off in blocks of 16 entries, all pairs of a block at once: a lane holds its pixels' sixteen values in
registers, in which the running products and sums along the list are plain chains of multiplications and additions. The
records of the next block, and the indices of the one after it, are fetched while this one is worked on.
"""

import triton
import triton.language as tl

from .layout import ALPHA_MIN, BLOCK, TILE, TRANSMITTANCE_MIN, split_quads

PIXELS = tl.constexpr(TILE.value * TILE.value)


@triton.jit
def _entries(tile_list, position, end):
    """The next block of a list, -1 past its end."""
    at = position + tl.arange(0, BLOCK)
    return tl.load(tile_list + at, mask=at < end, other=-1)


@triton.jit
def _fetch(records, gaussians, RECORD: tl.constexpr):
    """The quads of a block's records; those of what is past the list's end are such that it reaches nothing."""
    places = gaussians.to(tl.int64)[:, None] * RECORD + tl.arange(0, 4)[None, :]
    quads = ()
    for quad in tl.static_range(RECORD // 4):
        quads = quads + (tl.load(records + places + 4 * quad, mask=(gaussians >= 0)[:, None], other=-100.0),)
    return quads


@triton.jit
def _unpack(quads, CHANNELS: tl.constexpr):
    """A block's records, as one tensor for each number of a record."""
    record = ()
    for quad in tl.static_range(len(quads)):
        record = record + split_quads(quads[quad])
    return record[: 7 + CHANNELS]


@triton.jit
def _blend(record, x, y, transmittance, alpha_max):
    """(weight, transmittance behind, alpha if it had no ceiling, alpha / (1 - alpha)) of all pairs of a block."""
    mean_x, mean_y, curve, slant, steep, level = record[0], record[1], record[2], record[3], record[4], record[5]
    dx = x[None, :] - mean_x[:, None]
    dy = y[None, :] - mean_y[:, None]
    u = slant[:, None] * dx + steep[:, None] * dy
    free = tl.exp2(level[:, None] + curve[:, None] * dx * dx - u * u)
    alpha = tl.minimum(free, alpha_max)
    alpha = tl.where(alpha >= ALPHA_MIN, alpha, 0.0)
    # alpha / (1 - alpha). A division would take ten instructions, for numbers that cannot occur here.
    root = tl.rsqrt(1.0 - alpha)
    odds = alpha * root * root
    first = (tl.arange(0, BLOCK) == 0)[:, None]
    behind = tl.cumprod(tl.where(first, transmittance[None, :], 1.0) * (1.0 - alpha), axis=0)
    # What is left of the light before a splat is behind / (1 - alpha), and that is behind + weight.
    weight = behind * odds
    is_open = behind + weight >= TRANSMITTANCE_MIN
    return tl.where(is_open, weight, 0.0), behind, free, tl.where(is_open, odds, 0.0)


@triton.jit(do_not_specialize=["width", "height", "columns", "background_step"])
def composite(
    records, gaussians, sources, starts, width, height, columns, background, background_step, alpha_max,
    image, alpha, depth, stops, seen, CHANNELS: tl.constexpr, RECORD: tl.constexpr,
):  # fmt: skip
    """Fill image, alpha and depth; for the backward pass, where each tile's list was left, and what was seen by then.

    ``background`` has ``background_step`` floats per pixel (0: one colour).
    """
    tile = tl.program_id(0)
    pixel = tl.arange(0, PIXELS)
    column = tile % columns * TILE + pixel % TILE
    row = tile // columns * TILE + pixel // TILE
    x, y = column + 0.5, row + 0.5
    inside = (column < width) & (row < height)
    none = tl.zeros((PIXELS,), tl.float32)
    transmittance = tl.where(inside, 1.0, none)
    covered, totals = none, (none,)
    for _ in tl.static_range(CHANNELS):
        totals = totals + (none,)
    position, end = tl.load(starts + tile), tl.load(starts + tile + 1)
    quads = _fetch(records, _entries(gaussians, position, end), RECORD)
    following = _entries(gaussians, position + BLOCK, end)
    is_open = position < end
    while is_open:
        next_quads = _fetch(records, following, RECORD)
        following = _entries(gaussians, position + 2 * BLOCK, end)
        source = _entries(sources, position, end)
        record = _unpack(quads, CHANNELS)
        weight, behind, free, odds = _blend(record, x, y, transmittance, alpha_max)
        covered += tl.sum(weight, axis=0)
        more = ()
        for c in tl.static_range(CHANNELS + 1):
            more = more + (totals[c] + tl.sum(weight * record[6 + c][:, None], axis=0),)
        totals = more
        tl.store(seen + source, 1, mask=source >= 0)
        # The last of the products is the least.
        transmittance = tl.min(behind, axis=0)
        position += BLOCK
        quads = next_quads
        is_open = (position < end) & (tl.max(transmittance) >= TRANSMITTANCE_MIN)
    tl.store(stops + tile, tl.minimum(position, end))
    place = row * width + column
    tl.store(alpha + place, covered, mask=inside)
    tl.store(depth + place, totals[0], mask=inside)
    for c in tl.static_range(CHANNELS):
        under = tl.load(background + place * background_step + c, mask=inside, other=0.0)
        tl.store(image + place * CHANNELS + c, totals[1 + c] + (1.0 - covered) * under, mask=inside)


@triton.jit
def split(value):
    """(high, low) part of a float32, exact: as many leading bits as a matrix unit takes, and what is left of them."""
    high = (value.to(tl.int32, bitcast=True) & -8192).to(tl.float32, bitcast=True)
    return high, value - high


@triton.jit(do_not_specialize=["width", "height", "columns"])
def composite_backward(
    records, gaussians, sources, starts, stops, width, height, columns, alpha_max,
    image, alpha, depth, to_image, to_alpha, to_depth, row_sums,
    CHANNELS: tl.constexpr, RECORD: tl.constexpr, SUMS: tl.constexpr, WITH_DEPTH: tl.constexpr,
):  # fmt: skip
    """Write the row of sums (see layout.py) of every entry that was seen.

    Front to back once more, in the same blocks. Of what lies behind a contribution only one number per pixel is needed:
    the rest of sum_i w_i (g . f_i), background included, which starts as g . image.

    The sums over the tile's pixels are products with 64 x 8 matrices, moments of the pixels' places and gradients of
    the image, and go to the matrix units: adding up ten numbers per entry across a warp would take more instructions
    than all the rest. These units read eleven bits of a float's mantissa. Places in a tile need no more; the other
    factors are split into two parts, which leaves 22.
    """
    tile = tl.program_id(0)
    position, end = tl.load(starts + tile), tl.load(stops + tile)
    if position == end:
        return
    pixel = tl.arange(0, PIXELS)
    left, top = tile % columns * TILE, tile // columns * TILE
    column, row = left + pixel % TILE, top + pixel // TILE
    x, y = column + 0.5, row + 0.5
    inside = (column < width) & (row < height)
    place = row * width + column
    kind = tl.arange(0, 8)[None, :]

    seen_alpha = tl.load(alpha + place, mask=inside, other=0.0)
    rest = -tl.load(to_alpha + place, mask=inside, other=0.0) * (1.0 - seen_alpha)
    channel = tl.maximum(kind - 1, 0)
    in_image = inside[:, None] & (kind >= 1) & (kind <= CHANNELS)
    slopes = tl.load(to_image + place[:, None] * CHANNELS + channel, mask=in_image, other=0.0)
    gradients = ()
    for c in tl.static_range(CHANNELS):
        gradient = tl.load(to_image + place * CHANNELS + c, mask=inside, other=0.0)
        rest += gradient * tl.load(image + place * CHANNELS + c, mask=inside, other=0.0)
        gradients = gradients + (gradient,)
    if WITH_DEPTH:
        gradient = tl.load(to_depth + place, mask=inside, other=0.0)
        rest += gradient * tl.load(depth + place, mask=inside, other=0.0)
        slopes = tl.where(kind == 0, gradient[:, None], slopes)
        gradients = (gradient,) + gradients
    slopes_high, slopes_low = split(slopes)

    center_x, center_y = left + 0.5 * TILE, top + 0.5 * TILE
    from_x, from_y = (x - center_x)[:, None], (y - center_y)[:, None]
    by_x = tl.where((kind == 1) | (kind == 4), from_x, tl.where(kind == 3, from_x * from_x, 1.0))
    by_y = tl.where((kind == 2) | (kind == 4), from_y, tl.where(kind == 5, from_y * from_y, 1.0))
    moments = tl.where(kind < 6, by_x * by_y, 0.0)
    centers = tl.where(kind == 6, center_x, tl.where(kind == 7, center_y, 0.0))

    transmittance = tl.where(inside, 1.0, 0.0)
    quads = _fetch(records, _entries(gaussians, position, end), RECORD)
    following = _entries(gaussians, position + BLOCK, end)
    while position < end:
        next_quads = _fetch(records, following, RECORD)
        following = _entries(gaussians, position + 2 * BLOCK, end)
        source = _entries(sources, position, end).to(tl.int64)[:, None]
        record = _unpack(quads, CHANNELS)
        weight, behind, free, odds = _blend(record, x, y, transmittance, alpha_max)
        own = gradients[0][None, :] * record[7 - WITH_DEPTH][:, None]
        for c in tl.static_range(1, CHANNELS + WITH_DEPTH):
            own += gradients[c][None, :] * record[7 - WITH_DEPTH + c][:, None]
        own *= weight
        after = rest[None, :] - tl.cumsum(own, axis=0)
        # At the ceiling alpha no longer depends on the Gaussian's shape and opacity.
        s = tl.where(free <= alpha_max, own - after * odds, 0.0)
        rest -= tl.sum(own, axis=0)
        transmittance = tl.min(behind, axis=0)

        s_high, s_low = split(s)
        geometry = tl.dot(s_high, moments, input_precision="tf32")
        geometry = tl.dot(s_low, moments, geometry, input_precision="tf32")
        high, low = split(weight)
        features = tl.dot(high, slopes_high, input_precision="tf32")
        features = tl.dot(low, slopes_high, features, input_precision="tf32")
        features = tl.dot(high, slopes_low, features, input_precision="tf32")

        target = row_sums + source * SUMS + kind
        tl.store(target, geometry + centers, mask=source >= 0)
        tl.store(target + 8, features, mask=(source >= 0) & (kind < SUMS - 8))
        position += BLOCK
        quads = next_quads
