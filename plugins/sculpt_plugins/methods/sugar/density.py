"""The density of Gaussians, and the distance that it implies (SuGaR, 4.1)."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from scipy.spatial import KDTree
from torch import Tensor

from sculpt_framework.types import Gaussians

NEIGHBOURS = 16
"""Gaussians, nearest first by their centres, whose sum the density at a place is (program)."""
_THINNEST = 1e-6
"""Object units: Gaussians count as at least so thick."""
_EMPTY = 1e-6
"""Density below which no Gaussian is in reach."""
_FULL = 1 - 1e-3
"""Density from which on the distance is next to 0, where the root of the logarithm has no slope to use."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Local:
    """Of places, and of the Gaussians near each."""

    near: Int64[Tensor, "n k"]
    white: Float[Tensor, "n k 3"]
    """Offsets from the Gaussians' centres along their axes, in standard deviations."""
    density: Float[Tensor, " n"]
    """d, the sum of opacity times Gaussian (eq. 1)."""
    slope: Float[Tensor, "n 3"]
    """Of the density by the place."""

    @property
    def best(self) -> Int64[Tensor, " n"]:
        """g*: the Gaussian that the place is fewest standard deviations from (eq. 3)."""
        rank = self.white.detach().square().sum(dim=2).argmin(dim=1, keepdim=True)
        return self.near.gather(1, rank)[:, 0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Implied:
    distance: Float[Tensor, " n"]
    """|f| = s sqrt(-2 log d), s the smallest size of g* (4.1)."""
    off: Float[Tensor, " n"]
    """Squared length of what is between the density's normal and that of g*, of the same side (eq. 10). The first has
    no gradient: g* is turned as its neighbours lie. In the program the neighbours' normals have one."""
    known: Bool[Tensor, " n"]
    """Where a Gaussian is in reach and the density has a slope: elsewhere both are 0, without gradient."""


def neighbours(gaussians: Gaussians, points: Float[Tensor, "n 3"]) -> Int64[Tensor, "n k"]:
    """The Gaussians whose centres are nearest."""
    count = min(NEIGHBOURS, len(gaussians))
    tree = KDTree(gaussians.means.detach().cpu().numpy())
    found = tree.query(points.detach().cpu().numpy(), k=count)[1]
    return torch.from_numpy(found).long().to(points.device).reshape(len(points), count)


def density_at(gaussians: Gaussians, points: Float[Tensor, "n 3"], near: Int64[Tensor, "n k"]) -> Local:
    sizes, turns = _of(gaussians.scales, near).clamp(min=_THINNEST), _of(gaussians.rotations, near)
    white = torch.einsum("nkij,nki->nkj", turns, points[:, None] - _of(gaussians.means, near)) / sizes
    weight = _of(gaussians.opacities, near) * (-0.5 * white.square().sum(dim=2)).exp()
    slope = -torch.einsum("nk,nkij,nkj->ni", weight, turns, white / sizes)
    return Local(near=near, white=white, density=weight.sum(dim=1), slope=slope)


def implied(gaussians: Gaussians, local: Local) -> Implied:
    """Differentiable in the Gaussians. A density of 1 and more is at the surface: distance 0, without gradient."""
    best, density = local.best, local.density
    slope = local.slope.detach()
    steep = slope.square().sum(dim=1)
    known = (density > _EMPTY) & (steep > 0) & torch.isfinite(steep)
    within = known & (density < _FULL)
    root = (-2 * torch.where(within, density, 0.5).log()).sqrt()
    size = _of(gaussians.scales[:, 0], best).clamp(min=_THINNEST)
    unit = torch.where(known[:, None], slope, 0.0) * torch.where(known, steep, 1.0).rsqrt()[:, None]
    cosine = (unit * _of(gaussians.rotations[:, :, 0], best)).sum(dim=1).abs()
    return Implied(
        distance=torch.where(within, size * root, 0.0), off=torch.where(known, 2 - 2 * cosine, 0.0), known=known
    )


def _of(values: Float[Tensor, "g ..."], rows: Int64[Tensor, "..."]) -> Float[Tensor, "..."]:
    """Not values[rows]: the gradient of that is added up by threads in any order, and runs would not repeat."""
    return values.index_select(0, rows.reshape(-1)).reshape(*rows.shape, *values.shape[1:])
