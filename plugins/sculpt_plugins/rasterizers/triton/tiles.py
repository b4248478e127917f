"""Which tiles a Gaussian reaches, and from it each tile's list of Gaussians by depth.

All Gaussians are sorted by depth once (32-bit keys, as many as there are Gaussians). Their tiles are then written down
in that order, and a stable sort by tile (16-bit keys up to two million pixels) leaves each tile's list sorted by depth.
One sort by tile and depth together would take 64-bit keys, as many as there are entries: at two entries per Gaussian it
moves several times the memory. As the entries of one Gaussian lie together before the second sort, their places serve
again as the rows that the backward pass writes its sums to, and nothing needs to be added up atomically.
"""

from dataclasses import dataclass

import torch
import triton
import triton.language as tl
from torch import Tensor

from .layout import GAUSSIANS, LOG2_OF_255, TILE, load_quad

MARGIN = tl.constexpr(1e-3)
"""Pixels that rounding may take off a Gaussian's reach, at most, where alpha is clear of its threshold."""


@triton.jit
def rows_reached(mean_y, curve, slant, steep, level, height):
    """(first, last) pixel row whose centres lie where alpha is at least 1/255; first > last: none."""
    reach = tl.sqrt((level + LOG2_OF_255) * (1.0 - slant * slant / curve)) / steep + MARGIN
    # Still floats: what is far outside the image does not fit an integer.
    top = tl.minimum(tl.maximum(tl.ceil(mean_y - reach - 0.5), 0.0), height * 1.0)
    bottom = tl.maximum(tl.minimum(tl.floor(mean_y + reach - 0.5), height - 1.0), -1.0)
    return top.to(tl.int32), bottom.to(tl.int32)


@triton.jit
def columns_reached(tile_row, top, bottom, mean_x, mean_y, curve, slant, steep, level, width):
    """(first, end) of the tiles in a row of tiles that hold a point where alpha is at least 1/255.

    Exact: the ellipse is cut by the strip of the row's pixel centres, and only the tiles that the piece reaches count.
    For given dy the ellipse's dx lie around -slant steep dy / a, with a = slant^2 - curve; they extend the most to the
    right where u = 0, to the left at the opposite point, or else at the strip's edge next to it.
    """
    upper = tl.maximum(tile_row * TILE, top) + 0.5 - mean_y
    lower = tl.minimum(tile_row * TILE + (TILE - 1), bottom) + 0.5 - mean_y
    a = slant * slant - curve
    room = level + LOG2_OF_255
    at_extreme = -slant / steep * tl.sqrt(-room / curve)
    bend = steep * slant / a
    narrowing = steep * steep * curve / a
    dy = tl.minimum(tl.maximum(at_extreme, upper), lower)
    right = tl.sqrt(tl.maximum(room + narrowing * dy * dy, 0.0) / a) - bend * dy
    dy = tl.minimum(tl.maximum(-at_extreme, upper), lower)
    left = -tl.sqrt(tl.maximum(room + narrowing * dy * dy, 0.0) / a) - bend * dy
    first = tl.minimum(tl.maximum(tl.ceil(mean_x + left - 0.5 - MARGIN), 0.0), width * 1.0).to(tl.int32)
    last = tl.maximum(tl.minimum(tl.floor(mean_x + right - 0.5 + MARGIN), width - 1.0), -1.0).to(tl.int32)
    return first // TILE, tl.where(last >= first, last // TILE + 1, first // TILE)


@triton.jit(do_not_specialize=["count", "width", "height", "columns"])
def write_entries(
    order, ends, counts, records, count, width, height, columns,
    keys, gaussians, first_entries, RECORD: tl.constexpr,
):  # fmt: skip
    """Write tile and Gaussian of every entry, Gaussians by depth, and where each Gaussian's entries begin.

    ``counts`` was found by the same arithmetic, but compiled into another kernel. Should the last bit of a product
    differ, then an entry too many is left out and one too few keeps the key it has, of no tile: within ``MARGIN``
    neither had a pixel to draw.
    """
    at = tl.program_id(0) * GAUSSIANS + tl.arange(0, GAUSSIANS)
    inside = at < count
    gaussian = tl.load(order + at, mask=inside, other=0)
    entries = tl.load(counts + gaussian, mask=inside, other=0)
    end = tl.load(ends + at, mask=inside, other=0)
    tl.store(first_entries + gaussian, end - entries, mask=inside)
    drawn = entries > 0
    mean_x, mean_y, curve, slant = load_quad(records, gaussian * RECORD, drawn)
    steep, level, _, _ = load_quad(records, gaussian * RECORD + 4, drawn)
    curve, steep = tl.where(drawn, curve, -1.0), tl.where(drawn, steep, 1.0)
    top, bottom = rows_reached(mean_y, curve, slant, steep, level, height)
    rows = tl.where(drawn, bottom // TILE - top // TILE + 1, 0)
    position = end - entries
    # No "for": up to Triton 3.6 the interpreter cannot count to a tensor.
    row, most_rows = 0, tl.max(rows)
    while row < most_rows:
        tile_row = top // TILE + row
        first, stop = columns_reached(tile_row, top, bottom, mean_x, mean_y, curve, slant, steep, level, width)
        across = tl.where(row < rows, stop - first, 0)
        column, most = 0, tl.max(across)
        while column < most:
            chosen = (column < across) & (position + column < end)
            tl.store(keys + position + column, tile_row * columns + first + column, mask=chosen)
            tl.store(gaussians + position + column, gaussian, mask=chosen)
            column += 1
        position += across
        row += 1


@dataclass(frozen=True, kw_only=True, eq=False)
class TileLists:
    """Each tile's Gaussians front to back, one list after the other."""

    starts: Tensor
    """(tiles + 1) int32: where each list begins, and the end of the last."""
    gaussians: Tensor
    """(entries) int32."""
    sources: Tensor
    """(entries) int32: the entry's place before the sort by tile, where a Gaussian's entries lie together."""
    first_entries: Tensor
    """(Gaussians) int32: the first of these places."""
    counts: Tensor
    """(Gaussians) int32: how many there are."""


def tile_lists(records: Tensor, depths: Tensor, counts: Tensor, width: int, height: int) -> TileLists:
    """Lists from what ``project`` has written. Waits once for the device: for the number of entries.

    Raises ValueError for more of them than 32 bits number.
    """
    count, device = counts.shape[0], counts.device
    columns, rows = -(-width // TILE.value), -(-height // TILE.value)
    tiles = columns * rows
    order = torch.sort(depths, stable=True).indices
    ends = torch.cumsum(counts[order], 0)
    entries = int(ends[-1]) if count > 0 else 0
    if entries >= 2**31:
        raise ValueError(
            f"{entries} pairs of a Gaussian and a tile; 32 bits number them. Are the scales in object units?"
        )
    key_type = torch.int16 if tiles < 2**15 else torch.int32
    keys = torch.full((entries,), tiles, dtype=key_type, device=device)
    gaussians = torch.empty(entries, dtype=torch.int32, device=device)
    first_entries = torch.empty(count, dtype=torch.int32, device=device)
    if entries > 0:
        write_entries[(-(-count // GAUSSIANS.value),)](
            order, ends, counts, records, count, width, height, columns,
            keys, gaussians, first_entries, RECORD=records.shape[1],
        )  # fmt: skip
    keys, sources = torch.sort(keys, stable=True)
    return TileLists(
        starts=torch.searchsorted(keys, torch.arange(tiles + 1, dtype=key_type, device=device), out_int32=True),
        gaussians=gaussians[sources],
        sources=sources.int(),
        first_entries=first_entries,
        counts=counts,
    )
