"""NeRF (Mildenhall et al. 2020): density and colour by place and direction, whatever they mean."""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.volume_rendering.occupancy import corner_values, grid_cells_in, within
from sculpt_framework.volume_rendering.radiance import ColorDecoder, encoding_of
from sculpt_framework.volume_rendering.stretches import OccupiedCells, Rays, Stretches
from sculpt_framework.volume_rendering.volume import Volume
from sculpt_plugins.methods.nerf.config import NerfConfig

_START, _START_FALL, _MOST = 1.0, 4.0, 10.0
"""Logarithm of the density at the middle before anything is learned, how it falls with the square of the distance, so
that there is a surface from the beginning, and the most it can be."""
_SHARE_OF_LARGEST = 0.5
"""The surface is nowhere denser than this share of the densest place that is known."""


class NerfVolume(Volume):
    """The surface is where a cell of the mesh's grid hides half of what is behind it.

    The paper samples by a coarse network what a fine one renders; here a grid of occupied cells says where to look.
    """

    def __init__(self, config: NerfConfig):
        super().__init__()
        self._rates = config.radiance.rate, config.radiance.decoder_rate
        self._encoding = encoding_of(config.radiance)
        self._decoder = nn.Sequential(
            nn.Linear(2 * config.radiance.num_levels, config.radiance.hidden_units),
            nn.ReLU(),
            nn.Linear(config.radiance.hidden_units, 1 + config.features),
        )
        self._colors = ColorDecoder(config.features, config.radiance.hidden_units)

    def _decode(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n c"]:
        return self._decoder(self._encoding(points))

    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Per object unit. Its logarithm is what is learned (Müller et al. 2022): densities differ by thousands."""
        start = _START - _START_FALL * points.square().sum(dim=1)
        return (self._decode(points)[:, 0] + start).clamp(max=_MOST).exp()

    def alphas(self, rays: Rays, stretches: Stretches) -> Float[Tensor, " n"]:
        return -torch.expm1(-stretches.length * self.density(stretches.points(rays, 0.5)))

    def colors(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return self._colors(self._decode(points)[:, 1:], directions)

    def most_opaque(self, points: Float[Tensor, "n 3"], radius: float, step: float) -> Float[Tensor, " n"]:
        """At two places within the radius: there is no bound."""
        aside = points.new_tensor([1.0, 1.0, 1.0]) * (0.5 * radius / 3**0.5)
        return -torch.expm1(-step * torch.maximum(self.density(points - aside), self.density(points + aside)))

    def surface(self, grid: Grid, cells: OccupiedCells) -> tuple[SdfFunction, Int64[Tensor, " s"]]:
        ijk = grid_cells_in(grid, cells)
        densities = corner_values(self.density, grid, ijk)
        largest = float(densities.max()) if len(ijk) else 0.0
        threshold = min(math.log(2) / grid.cell, _SHARE_OF_LARGEST * largest)
        if not threshold > 0:
            raise EmptySurfaceError("nothing is dense anywhere")

        def level(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            missing = (1 - self.density(points) / threshold).clamp(min=-1)
            return grid.cell * torch.where(within(points, cells, cells.occupied), missing, 1.0)

        signs = corner_values(level, grid, ijk) < 0
        changing = signs.any(dim=1) & ~signs.all(dim=1)
        return level, grid.corner_keys(ijk[changing])

    def parameter_groups(self) -> list[ParameterGroup]:
        grid_rate, decoder_rate = self._rates
        decoders = [*self._decoder.parameters(), *self._colors.parameters()]
        return [
            ParameterGroup(parameters=list(self._encoding.parameters()), rate=grid_rate),
            ParameterGroup(parameters=decoders, rate=decoder_rate),
        ]

    def color_loss(self, made: Float[Tensor, "r 3"], wanted: Float[Tensor, "r 3"]) -> Float[Tensor, ""]:
        return (made - wanted).square().mean()  # paper, eq. 6
