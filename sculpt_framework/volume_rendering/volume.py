"""A volume that is seen along rays, and what rays bring of it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.volume_rendering.stretches import OccupiedCells, Rays, Stretches
from sculpt_framework.volume_rendering.weights import add_up, weigh

_TRACE = 1e-4
"""Share of what a ray brings that is not worth a colour."""
DARK = 1e-4
"""Share of a ray's light below which what lies behind is not asked for its colour."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What rays bring, over nothing."""

    rgb: Float[Tensor, "r 3"]
    alpha: Float[Tensor, " r"]
    depth: Float[Tensor, " r"]
    """Distance from the origin, times alpha."""


class Volume(nn.Module, ABC):
    """A shape that is seen along rays, and its colours. All in the object frame."""

    @abstractmethod
    def alphas(self, rays: Rays, stretches: Stretches) -> Float[Tensor, " n"]:
        """The opacity of each stretch, in [0, 1]."""

    @abstractmethod
    def colors(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """sRGB in [0, 1] of places, seen along unit directions."""

    @abstractmethod
    def most_opaque(self, points: Float[Tensor, "n 3"], radius: float, step: float) -> Float[Tensor, " n"]:
        """About the largest opacity of a step within ``radius`` of each point; 0 where no light gets to."""

    @abstractmethod
    def surface(self, grid: Grid, cells: OccupiedCells) -> tuple[SdfFunction, Int64[Tensor, " s"]]:
        """What is below 0 inside of the shape, and the keys, ascending, of the grid's cells that its zero may pass
        through: none may be left out."""

    @abstractmethod
    def parameter_groups(self) -> Sequence[ParameterGroup]: ...

    def color_loss(self, made: Float[Tensor, "r 3"], wanted: Float[Tensor, "r 3"]) -> Float[Tensor, ""]:
        """Of the colours that rays bring and should bring, both over the same background."""
        return (made - wanted).abs().mean()

    def shape_terms(self, rays: Rays, stretches: Stretches, generator: torch.Generator) -> dict[str, Float[Tensor, ""]]:
        """What is learned from besides, by name: terms of the shape itself."""
        return {}

    def facts(self) -> Mapping[str, Any]:
        """What is told of a step besides, as JSON values."""
        return {}


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """Some of the places that rays pass, ray by ray, and what share of what each ray brings comes from there."""

    rays: Rays
    ray: Int64[Tensor, " m"]
    distance: Float[Tensor, " m"]
    weight: Float[Tensor, " m"]

    @property
    def points(self) -> Float[Tensor, "m 3"]:
        return self.rays.origins.index_select(0, self.ray) + self.distance[:, None] * self.directions

    @property
    def directions(self) -> Float[Tensor, "m 3"]:
        return self.rays.directions.index_select(0, self.ray)

    def those(self, chosen: Bool[Tensor, " m"]) -> "Places":
        return replace(self, ray=self.ray[chosen], distance=self.distance[chosen], weight=self.weight[chosen])

    def bring(self, values: Float[Tensor, "m c"]) -> Float[Tensor, "r c"]:
        """The sum over each ray of weight times value."""
        counts = torch.bincount(self.ray, minlength=len(self.rays))
        return add_up(self.weight, values, torch.cat([counts.new_zeros(1), counts.cumsum(0)]))


def places_along(volume: Volume, rays: Rays, stretches: Stretches) -> tuple[Places, Float[Tensor, " r"]]:
    """The middles of stretches where light still arrives; without gradients, where more than a trace of what is seen
    comes from. And the light that comes through all of them."""
    weights, through = weigh(volume.alphas(rays, stretches), stretches)
    lit = _lit(weights.detach(), stretches) if torch.is_grad_enabled() else weights > _TRACE
    everywhere = Places(rays=rays, ray=stretches.ray, distance=stretches.middle, weight=weights)
    return everywhere.those(lit), through


def look_along(volume: Volume, rays: Rays, stretches: Stretches) -> Seen:
    """Render rays."""
    places, through = places_along(volume, rays, stretches)
    return seen_from(volume, places, through)


def seen_from(volume: Volume, places: Places, through: Float[Tensor, " r"]) -> Seen:
    """What ``places_along`` has found, with its colours."""
    colors = volume.colors(places.points, places.directions)
    brought = places.bring(torch.cat([colors, places.distance[:, None]], dim=1))
    return Seen(rgb=brought[:, :3], alpha=1 - through, depth=brought[:, 3])


def _lit(weights: Float[Tensor, " n"], stretches: Stretches) -> Bool[Tensor, " n"]:
    """Stretches at which more than a trace of the ray's light arrives."""
    before = weights.double().cumsum(0) - weights
    start = torch.cat([before, before.new_zeros(1)])[stretches.offsets[:-1]]
    return 1 - (before - start[stretches.ray]) > DARK
