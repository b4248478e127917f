"""Where along rays to look: steps of equal length through the occupied cells of a box, or around known depths."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.cpu_kernels import array_of, float32_on_cpu, kernel_cache, share_threads

with kernel_cache("volume-rendering", Path(__file__).with_name("kernels.py")):
    from sculpt_framework.volume_rendering import kernels


@dataclass(frozen=True, kw_only=True, eq=False)
class Rays:
    """In the object frame; ``directions`` are unit."""

    origins: Float[Tensor, "r 3"]
    directions: Float[Tensor, "r 3"]

    def __len__(self) -> int:
        return len(self.origins)


@dataclass(frozen=True, kw_only=True, eq=False)
class OccupiedCells:
    """Cubes over the box around the origin: which of them may hold something."""

    occupied: Bool[Tensor, "x y z"]
    low: tuple[float, float, float]
    """The corner of the first, in the object frame."""
    cell: float
    """Side of one, object units."""

    @property
    def high(self) -> tuple[float, float, float]:
        x, y, z = (start + self.cell * n for start, n in zip(self.low, self.occupied.shape, strict=True))
        return x, y, z


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretches:
    """Steps along rays, ray by ray, each ray's from near to far."""

    ray: Int64[Tensor, " n"]
    begin: Float[Tensor, " n"]
    """Distance from the ray's origin, object units."""
    length: Float[Tensor, " n"]
    """Object units; no two of a ray overlap."""
    offsets: Int64[Tensor, " r1"]
    """First stretch of each ray, and at the end how many there are."""

    def __len__(self) -> int:
        return len(self.ray)

    def points(self, rays: Rays, share: float) -> Float[Tensor, "n 3"]:
        """The place in each that lies this share of its length behind its beginning."""
        return self.at(rays, self.ray, self.begin + share * self.length)

    @property
    def middle(self) -> Float[Tensor, " n"]:
        return self.begin + 0.5 * self.length

    def at(self, rays: Rays, ray: Int64[Tensor, " m"], distance: Float[Tensor, " m"]) -> Float[Tensor, "m 3"]:
        origins, directions = rays.origins.index_select(0, ray), rays.directions.index_select(0, ray)
        return origins + distance[:, None] * directions

    def but_of(self, left_out: Bool[Tensor, " r"]) -> "Stretches":
        """Without those of some rays."""
        kept = ~left_out[self.ray]
        counts = torch.where(left_out, 0, self.offsets.diff())
        return Stretches(ray=self.ray[kept], begin=self.begin[kept], length=self.length[kept], offsets=_offsets(counts))

    @property
    def goes_on(self) -> Bool[Tensor, " n"]:
        """Whether the next stretch begins where this one ends."""
        linked = torch.zeros_like(self.ray, dtype=torch.bool)
        near = (self.begin[1:] - self.begin[:-1]) < 1.5 * self.length[:-1]
        linked[:-1] = near & (self.ray[1:] == self.ray[:-1])
        return linked


def stretches_of(rays: Rays, cells: OccupiedCells, step: float, jitter: Float[Tensor, " r"] | None = None) -> Stretches:
    """The steps whose middle lies in an occupied cell. No gradient reaches the rays.

    A ray's first step begins where it enters the box (or at its origin), moved on by ``jitter`` steps, from 0 to 1; the
    last may reach beyond the box. A ray that misses the box has none.
    """
    with torch.no_grad():
        near, far = _within(rays, cells)
        starts = near if jitter is None else near + jitter.to(near) * step
        numbers = ((far - starts) / step).ceil().clamp(min=0).to(torch.int64)
        find = _compiled if float32_on_cpu(rays.origins) else _in_torch
        ray, begin, counts = find(rays, cells, step, starts, numbers)
    offsets = _offsets(counts)
    return Stretches(ray=ray, begin=begin, length=begin.new_tensor(step).expand_as(begin), offsets=offsets)


def stretches_around(
    rays: Rays, middles: Float[Tensor, " r"], reach: Float[Tensor, " r"], count: int, jitter: Float[Tensor, " r"]
) -> Stretches:
    """``count`` stretches of one length on each ray, from ``reach`` in front of its middle to as far behind it, moved
    on by ``jitter`` stretches, from -0.5 to 0.5. A ray whose reach is 0 has none; one that would begin behind its
    origin begins at it. No gradient reaches the rays."""
    with torch.no_grad():
        chosen = (reach > 0).nonzero()[:, 0]
        length = 2 * reach[chosen] / count
        start = (middles[chosen] - reach[chosen] + jitter[chosen] * length).clamp(min=0)
        begin = start[:, None] + length[:, None] * torch.arange(count, device=start.device)
    return Stretches(
        ray=chosen.repeat_interleave(count),
        begin=begin.reshape(-1),
        length=length.repeat_interleave(count),
        offsets=_offsets(torch.where(reach > 0, count, 0)),
    )


def side_by_side(first: Stretches, second: Stretches) -> Stretches:
    """Those of rays of which each has stretches in one of the two alone."""
    ray = torch.cat([first.ray, second.ray])
    order = ray.argsort(stable=True)
    return Stretches(
        ray=ray[order],
        begin=torch.cat([first.begin, second.begin])[order],
        length=torch.cat([first.length, second.length])[order],
        offsets=first.offsets + second.offsets,
    )


def _offsets(counts: Int64[Tensor, " r"]) -> Int64[Tensor, " r1"]:
    return torch.cat([counts.new_zeros(1), counts.cumsum(0)])


def _within(rays: Rays, cells: OccupiedCells) -> tuple[Float[Tensor, " r"], Float[Tensor, " r"]]:
    """Where rays enter and leave the box, from their origin on; equal where they miss it."""
    # A direction along a wall would give 0 / 0; a hair beside it gives a distance that is far enough.
    slope = torch.where(rays.directions.abs() < 1e-12, 1e-12, rays.directions)
    first = (torch.tensor(cells.low).to(slope) - rays.origins) / slope
    second = (torch.tensor(cells.high).to(slope) - rays.origins) / slope
    near = torch.minimum(first, second).amax(dim=1).clamp(min=0)
    far = torch.maximum(first, second).amin(dim=1)
    return near, torch.maximum(near, far)


def _compiled(
    rays: Rays, cells: OccupiedCells, step: float, starts: Float[Tensor, " r"], numbers: Int64[Tensor, " r"]
) -> tuple[Int64[Tensor, " n"], Float[Tensor, " n"], Int64[Tensor, " r"]]:
    share_threads()
    counts = torch.zeros(len(rays), dtype=torch.int64)
    common = (
        array_of(rays.origins), array_of(rays.directions), array_of(starts), numbers.numpy(), np.float32(step),
        cells.occupied.numpy(), np.array(cells.low, np.float32), np.float32(1 / cells.cell),
    )  # fmt: skip
    kernels.count_stretches(*common, counts.numpy())
    offsets = counts.cumsum(0) - counts
    total = int(counts.sum())
    ray, begin = torch.empty(total, dtype=torch.int64), torch.empty(total)
    kernels.place_stretches(*common, offsets.numpy(), ray.numpy(), begin.numpy())
    return ray, begin, counts


def _in_torch(
    rays: Rays, cells: OccupiedCells, step: float, starts: Float[Tensor, " r"], numbers: Int64[Tensor, " r"]
) -> tuple[Int64[Tensor, " n"], Float[Tensor, " n"], Int64[Tensor, " r"]]:
    """The same on any device and in any floating-point type, with room for as many steps on all rays as on one."""
    k = torch.arange(int(numbers.max()) if len(numbers) else 0, device=starts.device)
    middles = starts[:, None] + (k + 0.5) * step
    points = rays.origins[:, None] + middles[..., None] * rays.directions[:, None]
    place = ((points - torch.tensor(cells.low).to(points)) / cells.cell).floor().long()
    top = torch.tensor(cells.occupied.shape, device=place.device) - 1
    x, y, z = place.clamp(min=0).minimum(top).unbind(dim=2)
    kept = cells.occupied[x, y, z] & (k < numbers[:, None])
    ray, step_number = kept.nonzero(as_tuple=True)
    return ray, starts[ray] + step_number * step, kept.sum(dim=1)
