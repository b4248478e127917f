"""The hash grid in Triton, for CUDA devices: a launch per level and direction, one lane per point."""

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

# A launch, kernel[grid](...), is to the checker a call of the function, and does not know Triton's own options.
# pyright: reportCallIssue=false, reportGeneralTypeIssues=false

_POINTS = 128
"""Of a program."""


class TritonEncoding(torch.autograd.Function):
    """``encode_in_torch`` for float32 on a CUDA device, level by level. Not differentiable twice.

    Gradients by the tables are added up atomically: from run to run they differ in their last bits.
    """

    @staticmethod
    def forward(ctx, points: Tensor, resolutions: tuple[int, ...], sum_levels: bool, *tables: Tensor) -> Tensor:
        ctx.resolutions = resolutions
        ctx.width = 0 if sum_levels else tables[0].shape[1]
        points = points.contiguous()
        ctx.save_for_backward(points, *tables)
        features = tables[0].shape[1]
        out = points.new_zeros(points.shape[0], features if sum_levels else len(tables) * features)
        for level, (table, resolution) in enumerate(zip(tables, resolutions, strict=True)):
            _launch(encode, points, resolution, table, level * ctx.width, out, table)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, to_out: Tensor) -> tuple[Tensor | None, ...]:
        points, *tables = ctx.saved_tensors
        to_out = to_out.contiguous()
        to_points = torch.zeros_like(points) if ctx.needs_input_grad[0] else None
        to_tables: list[Tensor | None] = [None] * len(tables)
        for level, (table, resolution) in enumerate(zip(tables, ctx.resolutions, strict=True)):
            if to_points is not None:
                _launch(differentiate_points, points, resolution, table, level * ctx.width, to_out, table, to_points)
            if ctx.needs_input_grad[3 + level]:
                to_tables[level] = torch.zeros_like(table)
                _launch(differentiate_table, points, resolution, table, level * ctx.width, to_out, to_tables[level])
        return to_points, None, None, *to_tables


def _launch(
    kernel: "triton.JITFunction", points: Tensor, resolution: int, table: Tensor, column: int, *tensors: Tensor | None
) -> None:
    count, (entries, features) = points.shape[0], table.shape
    if count == 0:
        return
    kernel[(triton.cdiv(count, _POINTS),)](
        points, *tensors, count, resolution, entries, column, tensors[0].shape[1],  # pyright: ignore
        FEATURES=features, PADDED=triton.next_power_of_2(features), DENSE=(resolution + 1) ** 3 <= entries,
        POINTS=_POINTS,
    )  # fmt: skip


@triton.jit
def _cell(value, resolution):
    """(index, fraction) of the cell a coordinate in [-1, 1] lies in; clamped outside, cell 0 and NaN for NaN."""
    position = 0.5 * (tl.minimum(tl.maximum(value, -1.0), 1.0) + 1.0) * resolution
    position = tl.where(value == value, position, 0.0)
    index = tl.minimum(position.to(tl.int32), resolution - 1)
    return index, tl.where(value == value, position - index.to(tl.float32), value)


@triton.jit
def _lanes(count, column, width, FEATURES: tl.constexpr, PADDED: tl.constexpr, POINTS: tl.constexpr):
    """Points of a program, which there are, features, where these stand in rows of the width, which count."""
    n = tl.program_id(0).to(tl.int64) * POINTS + tl.arange(0, POINTS)
    f = tl.arange(0, PADDED)[None, :]
    inside = n < count
    return n, inside, f, n[:, None] * width + column + f, inside[:, None] & (f < FEATURES)


@triton.jit
def _cells(points, n, inside, resolution):
    x, along_x = _cell(tl.load(points + 3 * n, mask=inside, other=0.0), resolution)
    y, along_y = _cell(tl.load(points + 3 * n + 1, mask=inside, other=0.0), resolution)
    z, along_z = _cell(tl.load(points + 3 * n + 2, mask=inside, other=0.0), resolution)
    return (x, y, z), (along_x, along_y, along_z)


@triton.jit
def _row(cell, corner: tl.constexpr, resolution, entries, DENSE: tl.constexpr):
    """Where a corner's features are; see ``corner_entries``."""
    x = (cell[0] + (corner & 1)).to(tl.int64)
    y = (cell[1] + (corner >> 1 & 1)).to(tl.int64)
    z = (cell[2] + (corner >> 2)).to(tl.int64)
    if DENSE:
        side = resolution + 1
        row = (z * side + y) * side + x
    else:
        row = (x ^ y * 2654435761 ^ z * 805459861) & (entries - 1)
    return row


@triton.jit
def _share(fraction, upper: tl.constexpr):
    if upper:
        share = fraction
    else:
        share = 1.0 - fraction
    return share


@triton.jit
def _weight(along, corner: tl.constexpr):
    """Of a corner, for each point and all of its features."""
    share = _share(along[0], corner & 1) * _share(along[1], corner >> 1 & 1) * _share(along[2], corner >> 2)
    return share[:, None]


@triton.jit
def encode(
    points, out, table, count, resolution, entries, column, width,
    FEATURES: tl.constexpr, PADDED: tl.constexpr, DENSE: tl.constexpr, POINTS: tl.constexpr,
):  # fmt: skip
    """out[:, column : column + features] += trilinear features."""
    n, inside, f, at, mask = _lanes(count, column, width, FEATURES, PADDED, POINTS)
    cell, along = _cells(points, n, inside, resolution)
    total = tl.load(out + at, mask=mask, other=0.0)
    for corner in tl.static_range(8):
        row = _row(cell, corner, resolution, entries, DENSE)
        total += _weight(along, corner) * tl.load(table + row[:, None] * FEATURES + f, mask=mask, other=0.0)
    tl.store(out + at, total, mask=mask)


@triton.jit
def differentiate_table(
    points, to_out, to_table, count, resolution, entries, column, width,
    FEATURES: tl.constexpr, PADDED: tl.constexpr, DENSE: tl.constexpr, POINTS: tl.constexpr,
):  # fmt: skip
    """Add the gradient by the table to ``to_table``."""
    n, inside, f, at, mask = _lanes(count, column, width, FEATURES, PADDED, POINTS)
    slopes = tl.load(to_out + at, mask=mask, other=0.0)
    # Of a surface's Gaussians one view shows less than half; what the others say is not asked.
    mask = mask & (slopes != 0.0)
    cell, along = _cells(points, n, inside, resolution)
    for corner in tl.static_range(8):
        row = _row(cell, corner, resolution, entries, DENSE)
        part = _weight(along, corner) * slopes
        tl.atomic_add(to_table + row[:, None] * FEATURES + f, part, mask=mask, sem="relaxed")


@triton.jit
def differentiate_points(
    points, to_out, table, to_points, count, resolution, entries, column, width,
    FEATURES: tl.constexpr, PADDED: tl.constexpr, DENSE: tl.constexpr, POINTS: tl.constexpr,
):  # fmt: skip
    """Add the gradient by position to ``to_points``; nothing along an axis where a point is clamped."""
    n, inside, f, at, mask = _lanes(count, column, width, FEATURES, PADDED, POINTS)
    slopes = tl.load(to_out + at, mask=mask, other=0.0)
    cell, along = _cells(points, n, inside, resolution)
    to_x = tl.zeros([POINTS], tl.float32)
    to_y = tl.zeros([POINTS], tl.float32)
    to_z = tl.zeros([POINTS], tl.float32)
    for corner in tl.static_range(8):
        row = _row(cell, corner, resolution, entries, DENSE)
        value = tl.sum(slopes * tl.load(table + row[:, None] * FEATURES + f, mask=mask, other=0.0), axis=1)
        x = _share(along[0], corner & 1)
        y = _share(along[1], corner >> 1 & 1)
        z = _share(along[2], corner >> 2)
        to_x += y * z * value * (2.0 * (corner & 1) - 1.0)
        to_y += x * z * value * (2.0 * (corner >> 1 & 1) - 1.0)
        to_z += x * y * value * (2.0 * (corner >> 2) - 1.0)
    slope = 0.5 * resolution
    _add_unclamped(points + 3 * n, to_points + 3 * n, slope * to_x, inside)
    _add_unclamped(points + 3 * n + 1, to_points + 3 * n + 1, slope * to_y, inside)
    _add_unclamped(points + 3 * n + 2, to_points + 3 * n + 2, slope * to_z, inside)


@triton.jit
def _add_unclamped(coordinate, to_coordinate, gradient, inside):
    free = inside & (tl.abs(tl.load(coordinate, mask=inside, other=2.0)) <= 1.0)
    tl.store(to_coordinate, tl.load(to_coordinate, mask=free, other=0.0) + gradient, mask=free)
