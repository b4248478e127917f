"""Features on a pyramid of grids, fine ones hashed into tables (Müller et al. 2022)."""

import logging
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from sculpt_framework.cpu_kernels import array_of, kernel_cache, share_threads
from sculpt_framework.errors import first_line
from sculpt_framework.geometry.band import corner_offsets
from sculpt_framework.triton_package import require_triton

with kernel_cache("hash-grid", Path(__file__).with_name("hash_grid_kernels.py")):
    from sculpt_framework.encodings import hash_grid_kernels

if TYPE_CHECKING:
    from sculpt_framework.encodings.hash_grid_triton import TritonEncoding

PRIMES = (1, 2654435761, 805459861)
"""Factors of a corner's indices in the hash, of which the low bits count."""


class HashEncoding(nn.Module):
    """Trilinear features of points in [-1, 1]^3 on several grids; points outside are taken at the nearest wall.

    Grid sizes grow geometrically from ``base_resolution`` to ``finest_resolution`` cells across, and are rounded. A
    grid whose corners fit a table of 2^log2_table entries is stored corner by corner, without collisions. Tables start
    uniformly random within ``init_scale`` of zero. Each level is a parameter of its own: an inactive one gets no
    gradient, so that an optimiser spends nothing on it either. With ``sum_levels`` the levels' features are added up,
    else they are written side by side.
    """

    def __init__(
        self,
        *,
        levels: int,
        features_per_level: int,
        log2_table: int,
        base_resolution: float | int,
        finest_resolution: int,
        init_scale: float,
        sum_levels: bool = False,
    ):
        super().__init__()
        if not (levels >= 1 and features_per_level >= 1 and 1 <= log2_table <= 31):
            raise ValueError(
                f"hash grid with {levels} levels of {features_per_level} features in tables of 2^{log2_table} entries: "
                "at least one level and feature, and tables of 2^1 to 2^31"
            )
        if not 1 <= base_resolution <= finest_resolution:
            raise ValueError(
                f"hash grid from {base_resolution} to {finest_resolution} cells: from 1 upwards, coarsest first"
            )
        if levels == 1 and base_resolution != finest_resolution:
            raise ValueError(f"hash grid of one level from {base_resolution} to {finest_resolution} cells")
        growth = (finest_resolution / base_resolution) ** (1.0 / max(levels - 1, 1))
        self.resolutions = tuple(round(base_resolution * growth**level) for level in range(levels))
        """Cells across [-1, 1], coarsest first."""
        self.features_per_level = features_per_level
        self.sum_levels = sum_levels
        sizes = [min((resolution + 1) ** 3, 2**log2_table) for resolution in self.resolutions]
        self.tables = nn.ParameterList(
            nn.Parameter(torch.empty(size, features_per_level).uniform_(-init_scale, init_scale)) for size in sizes
        )

    def forward(self, points: Float[Tensor, "n 3"], active_levels: int | None = None) -> Float[Tensor, "n c"]:
        """Features of all levels, coarsest first, or their sum; beyond ``active_levels`` 0, at no cost."""
        active = len(self.resolutions) if active_levels is None else active_levels
        if not 0 <= active <= len(self.resolutions):
            raise ValueError(f"{active} active levels of a hash grid that has {len(self.resolutions)}")
        tables, resolutions = list(self.tables)[:active], self.resolutions[:active]
        kernels = _kernels(points.device.type) if active and points.dtype == tables[0].dtype == torch.float32 else None
        if kernels is not None:
            encoded = kernels.apply(points, resolutions, self.sum_levels, *tables)
        else:
            encoded = encode_in_torch(points, tables, resolutions, self.sum_levels)
        if self.sum_levels:
            return encoded
        idle = (len(self.resolutions) - active) * self.features_per_level
        return torch.cat([encoded, encoded.new_zeros(points.shape[0], idle)], dim=1) if idle else encoded


@cache
def _kernels(device: str) -> "type[_CompiledEncoding | TritonEncoding] | None":
    """What is compiled for a type of device. Triton comes with torch for CUDA on Linux; elsewhere torch does it."""
    if device == "cuda" and find_spec("triton") is not None:
        return triton_on(device)
    return _CompiledEncoding if device == "cpu" else None


def triton_on(device: str) -> "type[TritonEncoding] | None":
    """None, and a warning, where Triton is too old or does not run: its first launch needs a C compiler."""
    try:
        require_triton("the hash grid", "let torch do it")
        from sculpt_framework.encodings.hash_grid_triton import TritonEncoding

        TritonEncoding.apply(torch.zeros(1, 3, device=device), (1,), True, torch.zeros(8, 1, device=device))
    except Exception as error:  # A missing compiler, driver or header shows as anything.
        logging.getLogger("sculpt").warning(
            "hash grid: torch does it, which is slower, as Triton fails (%s)", first_line(error)
        )
        return None
    return TritonEncoding


class _CompiledEncoding(torch.autograd.Function):
    """``encode_in_torch`` for float32 on the CPU, level by level. Not differentiable twice."""

    @staticmethod
    def forward(ctx, points: Tensor, resolutions: tuple[int, ...], sum_levels: bool, *tables: Tensor) -> Tensor:
        ctx.resolutions = resolutions
        ctx.width = 0 if sum_levels else tables[0].shape[1]
        ctx.save_for_backward(points, *tables)
        share_threads()
        features = tables[0].shape[1]
        out = torch.zeros(points.shape[0], features if sum_levels else len(tables) * features)
        where = array_of(points)
        for level, (table, resolution) in enumerate(zip(tables, resolutions, strict=True)):
            values = array_of(table)
            hash_grid_kernels.encode_level(where, values, resolution, level * ctx.width, out.numpy())
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, to_out: Tensor) -> tuple[Tensor | None, ...]:
        points, *tables = ctx.saved_tensors
        threads = share_threads()
        where, slopes = array_of(points), array_of(to_out)
        levels = list(enumerate(zip(tables, ctx.resolutions, strict=True)))
        to_points = None
        if ctx.needs_input_grad[0]:
            to_points = torch.zeros(points.shape)
            for level, (table, resolution) in levels:
                values = array_of(table)
                hash_grid_kernels.differentiate_points(
                    where, values, resolution, level * ctx.width, slopes, to_points.numpy()
                )
        to_tables: list[Tensor | None] = [None] * len(tables)

        def differentiate_table(level: int) -> None:
            if ctx.needs_input_grad[3 + level]:
                to_table = torch.zeros(tables[level].shape)
                hash_grid_kernels.differentiate_table(
                    where, ctx.resolutions[level], level * ctx.width, slopes, to_table.numpy()
                )
                to_tables[level] = to_table

        # The finest first: they take longest.
        _on_threads(differentiate_table, reversed(range(len(tables))), threads)
        return to_points, None, None, *to_tables


def _on_threads(work: Callable[[int], None], items: Iterable[int], threads: int) -> None:
    """Do the work for each item; the kernels in it let go of the interpreter."""
    if threads == 1:
        for item in items:
            work(item)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, items):
            pass


def encode_in_torch(
    points: Float[Tensor, "n 3"], tables: list[Tensor], resolutions: tuple[int, ...], sum_levels: bool = False
) -> Float[Tensor, "n c"]:
    """The encoding in plain torch: any device and floating-point type."""
    if not tables:
        return points.new_zeros(points.shape[0], 0)
    inside = 0.5 * (points.clamp(-1.0, 1.0) + 1.0)
    levels = [
        _level(inside * resolution, table, resolution) for table, resolution in zip(tables, resolutions, strict=True)
    ]
    return torch.stack(levels).sum(dim=0) if sum_levels else torch.cat(levels, dim=1)


def _level(position: Float[Tensor, "n 3"], table: Float[Tensor, "e c"], resolution: int) -> Float[Tensor, "n c"]:
    """Trilinear interpolation at ``position`` in cells."""
    # A point on the upper wall belongs to the last cell. Clamped as an integer, because a NaN becomes any number.
    cell = position.detach().floor().long().clamp(0, resolution - 1)
    upper = position - cell
    lower = 1.0 - upper
    total = position.new_zeros(position.shape[0], table.shape[1])
    for bits in corner_offsets(position.device):
        weight = torch.where(bits == 1, upper, lower).prod(dim=1, keepdim=True)
        total = total + weight * table[corner_entries(cell + bits, resolution, table.shape[0])]
    return total


def corner_entries(corner: Int64[Tensor, "n 3"], resolution: int, entries: int) -> Int64[Tensor, " n"]:
    """Where a grid corner's features are: in reading order if all corners fit the table, else by hash."""
    x, y, z = corner.unbind(dim=1)
    side = resolution + 1
    if side**3 <= entries:
        return (z * side + y) * side + x
    return (x * PRIMES[0] ^ y * PRIMES[1] ^ z * PRIMES[2]) & (entries - 1)
