"""A signed distance field as a volume: what NeuS and VolSDF have in common."""

from dataclasses import replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.volume_rendering.config import SdfShape
from sculpt_framework.volume_rendering.radiance import RadianceField
from sculpt_framework.volume_rendering.stretches import OccupiedCells, Rays, Stretches
from sculpt_framework.volume_rendering.volume import Volume

_STEEPEST = 2.0
"""While it is learned, the field is only roughly a distance: it may change by so much per unit of length."""
_EIKONAL_POINTS = 2048
"""Of either kind, on the rays and anywhere in the cube around the box."""
_NEAR_SURFACE = 0.05
"""Object units."""


class SdfVolume(Volume):
    """A field, a radiance field beside it if it has colours, and terms of the field's own shape."""

    def __init__(self, shape: SdfShape):
        super().__init__()
        self._weights, self._field_rate = shape.weights, shape.field_rate
        self._spacing = 2.0 / shape.mesh_cells
        self.field = shape.field.build(shape.mesh_cells, torch.device("cpu"))
        self.field.set_detail(self._spacing)
        self._radiance = None if shape.radiance is None else RadianceField(shape.radiance)

    def colors(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        assert self._radiance is not None, "a volume without colours was asked for some"  # noqa: S101
        return self._radiance(points, directions)

    def surface(self, grid: Grid, cells: OccupiedCells) -> tuple[SdfFunction, Int64[Tensor, " s"]]:
        device = cells.occupied.device
        return self.field, discover(self.field, grid, coarse_level=0, lipschitz=_STEEPEST, device=device)

    def parameter_groups(self) -> list[ParameterGroup]:
        own = [replace(group, rate=self._field_rate * group.rate) for group in self.field.parameter_groups()]
        return own if self._radiance is None else [*own, *self._radiance.parameter_groups()]

    def shape_terms(self, rays: Rays, stretches: Stretches, generator: torch.Generator) -> dict[str, Float[Tensor, ""]]:
        if self._weights.eikonal == 0 and self._weights.bending == 0:
            return {}
        device = rays.origins.device
        points = 2 * torch.rand(_EIKONAL_POINTS, 3, generator=generator).to(device) - 1
        if len(stretches):
            chosen = torch.randint(len(stretches), (_EIKONAL_POINTS,), generator=generator).to(device)
            points = torch.cat([points, stretches.at(rays, stretches.ray[chosen], stretches.middle[chosen])])
        around = values_around(self.field, points, self._spacing)
        terms = {"eikonal": self._weights.eikonal * eikonal(slopes_of(around, self._spacing))}
        if self._weights.bending > 0 and len(stretches):
            middle = self.field(points[_EIKONAL_POINTS:])
            bent = bending(around[:, :, _EIKONAL_POINTS:], middle, self._spacing)
            terms["bending"] = self._weights.bending * bent
        return terms


def nearest(sdf: Float[Tensor, " n"], radius: float) -> Float[Tensor, " n"]:
    """About the distance nearest to 0 within ``radius`` of places with these."""
    return sdf.sign() * (sdf.abs() - radius).clamp(min=0)


def slopes(field: torch.nn.Module, points: Float[Tensor, "n 3"], spacing: float) -> Float[Tensor, "n 3"]:
    """The gradient of a field by central differences over ``spacing``: differentiable once more whatever the field,
    and blind to what is finer (Li et al. 2023, Neuralangelo)."""
    return slopes_of(values_around(field, points, spacing), spacing)


def values_around(field: torch.nn.Module, points: Float[Tensor, "n 3"], spacing: float) -> Float[Tensor, "2 3 n"]:
    """The field half a ``spacing`` ahead of each point and behind it, along each axis."""
    offsets = 0.5 * spacing * torch.eye(3, device=points.device, dtype=points.dtype)
    around = points[None, None] + torch.stack([offsets, -offsets])[:, :, None]
    return field(around.reshape(-1, 3)).reshape(2, 3, len(points))


def slopes_of(around: Float[Tensor, "2 3 n"], spacing: float) -> Float[Tensor, "n 3"]:
    return ((around[0] - around[1]) / spacing).T


def bending(around: Float[Tensor, "2 3 n"], middle: Float[Tensor, " n"], spacing: float) -> Float[Tensor, ""]:
    """Mean size of a distance's Laplacian, by differences over half a ``spacing``, which is twice the mean curvature of
    its level sets (Neuralangelo, 3.3); of the points within ``_NEAR_SURFACE`` of zero. 0 where none is so near."""
    near = middle.detach().abs() < _NEAR_SURFACE
    laplacian = (around.sum(dim=(0, 1)) - 6 * middle) / (0.5 * spacing) ** 2
    return torch.where(near, laplacian.abs(), 0.0).sum() / near.sum().clamp(min=1)


def eikonal(slope: Float[Tensor, "n 3"]) -> Float[Tensor, ""]:
    """Mean squared difference of its length from 1. A slope of zero has no direction and gets no gradient."""
    squared = slope.square().sum(dim=1)
    length = torch.where(squared > 0, squared, 1.0).sqrt()
    return (torch.where(squared > 0, length, 0.0) - 1).square().mean()
