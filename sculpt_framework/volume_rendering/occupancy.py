"""Where something may be: cells that rays need not pass over."""

import math
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import corner_offsets
from sculpt_framework.geometry.grid import Grid, unpack_ijk
from sculpt_framework.volume_rendering.stretches import OccupiedCells

LEAST_OPACITY = 1e-3
"""Of a step: cells with less are passed over."""
_FADING = 0.7
"""What was seen in a cell counts by so much less each time it is looked at again."""
_POINTS = 1 << 18


class Occupancy:
    """The largest opacity of late at random places of each cell.

    To begin with, all of the box counts as occupied. The box around the origin has the half sides that are given.
    """

    def __init__(self, half_sides: Float[Tensor, " 3"], cells: int, device: torch.device):
        self._cell = 2 * float(half_sides.max()) / cells
        x, y, z = (max(1, round(2 * float(side) / self._cell + 0.499)) for side in half_sides)
        self._low = (-0.5 * x * self._cell, -0.5 * y * self._cell, -0.5 * z * self._cell)
        self.opacity = torch.ones(x, y, z, device=device)

    @property
    def cells(self) -> OccupiedCells:
        return OccupiedCells(occupied=self.opacity > LEAST_OPACITY, low=self._low, cell=self._cell)

    @torch.no_grad()
    def look(
        self, most: Callable[[Tensor, float], Tensor], generator: torch.Generator, *, afresh: bool = False
    ) -> None:
        """Ask anew for the opacity of a step: ``most(points, radius)`` is the largest that may be found as near to each
        of the points as that. ``afresh`` forgets what was seen before."""
        shape = self.opacity.shape
        places = torch.cartesian_prod(*(torch.arange(n) for n in shape))
        jitter = torch.rand(len(places), 3, generator=generator)
        points = torch.tensor(self._low) + self._cell * (places + jitter)
        radius = 0.5 * 3**0.5 * self._cell
        seen = torch.cat([most(part.to(self.opacity.device), radius) for part in points.split(_POINTS)])
        seen = seen.reshape(shape).to(self.opacity)
        self.opacity = seen if afresh else torch.maximum(_FADING * self.opacity, seen)


def grid_cells_in(grid: Grid, cells: OccupiedCells) -> Int64[Tensor, "c 3"]:
    """The cells of a grid that touch an occupied one."""
    occupied = cells.occupied.float()[None, None]
    # All around as far as half a cell of the grid may reach beyond the walls of the one its middle is in.
    reach = math.ceil(grid.cell / cells.cell)
    wide = torch.nn.functional.max_pool3d(occupied, kernel_size=2 * reach + 1, stride=1, padding=reach)[0, 0] > 0
    ijk = torch.cartesian_prod(*(torch.arange(n, device=occupied.device) for n in grid.shape))
    middle = grid.corner_positions(ijk, torch.float32) + 0.5 * grid.cell
    return ijk[within(middle, cells, wide)]


def within(points: Float[Tensor, "n 3"], cells: OccupiedCells, wanted: Bool[Tensor, "x y z"]) -> Bool[Tensor, " n"]:
    """Which points lie in wanted cells; none outside of the box do."""
    place = ((points - torch.tensor(cells.low).to(points)) / cells.cell).floor().long()
    top = torch.tensor(wanted.shape, device=points.device) - 1
    inside = ((place >= 0) & (place <= top)).all(dim=1)
    x, y, z = place.clamp(min=0).minimum(top).unbind(dim=1)
    return inside & wanted[x, y, z]


def corner_values(function: Callable[[Tensor], Tensor], grid: Grid, ijk: Int64[Tensor, "c 3"]) -> Float[Tensor, "c 8"]:
    """What a function says at the corners of cells; each corner is asked for once."""
    corners = ijk[:, None] + corner_offsets(ijk.device)
    keys, row = grid.corner_keys(corners.reshape(-1, 3)).unique(return_inverse=True)
    positions = grid.corner_positions(unpack_ijk(keys), torch.float32)
    values = torch.cat([function(part) for part in positions.split(_POINTS)]) if len(keys) else positions[:, 0]
    return values[row].reshape(-1, 8)
