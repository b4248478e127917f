"""Grids with an arbitrary value at each corner."""

import torch
from torch import Tensor

from sculpt_framework.geometry.grid import Grid, pack
from sculpt_framework.geometry.signed_distance import SdfFunction


def unit_grid(shape: tuple[int, int, int]) -> Grid:
    """Cells of side 1, corner (0, 0, 0) at the origin."""
    return Grid(origin=(0.0, 0.0, 0.0), base_shape=shape, base_cell=1.0)


def all_cells(grid: Grid) -> Tensor:
    return pack(grid.level, torch.cartesian_prod(*(torch.arange(n) for n in grid.shape)))


def corner_lookup(values: Tensor) -> SdfFunction:
    """The sdf of a unit grid whose corner (i, j, k) has ``values[i, j, k]``; differentiable in the values."""

    def sdf(points: Tensor) -> Tensor:
        i, j, k = points.detach().round().long().unbind(dim=1)
        return values[i, j, k]

    return sdf
