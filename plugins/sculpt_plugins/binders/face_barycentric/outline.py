"""How deep below their faces Gaussians lie, and how near to sharp edges they reach, for their outline to be the mesh's.

docs/background/splat-surface.md derives and measures it. With s the standard deviation of a flat splat seen edge-on:

depth   At a rim of curvature kappa, Gaussians of areal density rho and tangential deviation sigma have the optical
        depth tau(D) = N int Li_3/2(theta exp(-(D + u^2)^2 / 2)) du at the distance D s outside their centres, with
        N = rho sqrt(2 pi (sigma^2 + blur^2)) sqrt(2 s / kappa). Half coverage is tau = ln 2: there the face belongs.
        In a thin sheet they keep to their own side of it.
shift   Where the surface bends away over an edge, a Gaussian lies as deep below the neighbour's plane as below its own.
trim    With that plane seen edge-on its outline does not stand outside: its deviation across the plane, times D, is at
        most its depth below it.

All three are constants of a step: images move faces, not the angles between them.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from sculpt_plugins.binders.face_barycentric.limits import (
    FLAT,
    FLATTEST,
    LOG_LAYERS_FROM,
    LOG_LAYERS_STEP,
    LOG_LAYERS_TO,
    NARROWEST,
    OF_A_SHEET,
    TINY,
)
from sculpt_plugins.binders.face_barycentric.thickness import thicknesses

COLUMN = 2.0 * math.sqrt(2.0)
"""Width of the columns in which the other side of a sheet is looked for, over the root of a face's mean area: two cells
of a grid with two faces each."""
_LAYERS_AT_AN_EDGE = 2
"""Gaussians that overlap on an outline at the least: one of either face at an edge."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """What moves and trims the Gaussians of each face."""

    depth: Float[Tensor, " f"]
    """Below the face, in object units."""
    shift: Float[Tensor, "f k 3"]
    """Along the face, in object units."""
    trim: Float[Tensor, "f k 2 2"]
    """Matrices C by which tangential factors A of the covariances A A^T become A C."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Neighbourhood:
    """A surface as seen from each of its faces; edge j runs from corner j to the next. Faces come last: sums over three
    edges or coordinates are then sums of whole rows, several times as fast."""

    outward: Float[Tensor, "3 3 f"]
    """By edge and coordinate: unit vector in the face's plane, across the edge."""
    heights: Float[Tensor, "3 f"]
    """Of the triangle over each edge."""
    cosine: Float[Tensor, "3 f"]
    """Of the angle between the normals of the face and of its neighbour."""
    sine: Float[Tensor, "3 f"]
    """Of the same angle; 0 where the edge is not convex, or does not have exactly two faces."""
    reach: Float[Tensor, "3 2 f"]
    """By edge: components of both reference radii along ``outward``."""
    area: float
    """Mean over the faces."""
    thickness: Float[Tensor, " f"]
    """Of the solid below the face; infinite where it is not known to be thin."""

    @property
    def half_tangent(self) -> Float[Tensor, "3 f"]:
        """Tangent of half the angle; of a fold back onto itself, a large number."""
        return self.sine / (1.0 + self.cosine).clamp(min=FLAT)


@functools.cache
def rim_depths(opacity: float) -> Float64[np.ndarray, " n"]:
    """D at equal steps of ln N: the solutions of tau(D) = ln 2."""
    depths, places = np.linspace(0.0, 5.0, 101), np.linspace(-3.0, 3.0, 121)
    terms = np.arange(1, 80)
    # Li_3/2 is the optical depth of a row of Gaussians, summed along the row.
    peaks = opacity * np.exp(-0.5 * (depths[:, None] + places**2) ** 2)
    tau = (peaks[:, :, None] ** terms / terms**1.5).sum(axis=(1, 2)) * (places[1] - places[0])
    wanted = np.arange(LOG_LAYERS_FROM, LOG_LAYERS_TO + LOG_LAYERS_STEP, LOG_LAYERS_STEP)
    found = np.interp(wanted, math.log(math.log(2.0)) - np.log(tau), depths)
    least = 2.0 * math.log(opacity / (1.0 - 0.5 ** (1.0 / _LAYERS_AT_AN_EDGE)))
    return np.maximum(found, math.sqrt(max(least, 0.0)))


def fit_outline(
    neighbourhood: Neighbourhood,
    barycentrics: Float[Tensor, "f k 3"],
    mixing: Float[Tensor, "f k 2 2"],
    depths: Float[Tensor, " n"],
    *,
    blur: float,
    normal_scale: float,
) -> Fit:
    """Depths, shifts and trims of Gaussians with covariances A A^T, A = (reference radii) ``mixing``.

    ``depths`` is ``rim_depths`` of their opacity; ``blur`` is the deviation of the screen's filter, in object units.
    """
    width = math.hypot(blur, normal_scale)
    across = _across(neighbourhood, mixing)
    deviations = _interpolated(depths, _log_layers(neighbourhood, across, barycentrics.shape[1], width, blur))
    depth = width * deviations
    # The distance from edge j is the height times the share of the corner opposite.
    distance = barycentrics.permute(2, 1, 0).roll(-2, dims=0) * neighbourhood.heights[:, None]
    away = ((depth * neighbourhood.half_tangent)[:, None] - distance).clamp(min=0.0)
    # No further than the corner opposite.
    away = torch.minimum(away, neighbourhood.heights[:, None] - distance)
    shift = -(away[:, :, None] * neighbourhood.outward[:, None]).sum(dim=0)
    distance = distance - (shift * neighbourhood.outward[:, None]).sum(dim=2)
    below = (depth * neighbourhood.cosine)[:, None] + neighbourhood.sine[:, None] * distance
    # Deviations are 0 where so few layers of so low an opacity never cover half.
    spread = (below.clamp(min=0.0) / deviations.clamp(min=TINY)).square() - blur * blur
    return Fit(
        depth=torch.minimum(depth, OF_A_SHEET * neighbourhood.thickness),
        shift=shift.permute(2, 0, 1).contiguous(),
        trim=_trims(neighbourhood, across, spread - (normal_scale * neighbourhood.cosine)[:, None].square()),
    )


def neighbourhood_of(
    faces: Int64[Tensor, "f 3"],
    corners: Float[Tensor, "f 3 3"],
    normal: Float[Tensor, "f 3"],
    radii: Float[Tensor, "f 3 2"],
) -> Neighbourhood:
    """What the fit has to know of a surface, whatever its Gaussians; finite for faces of no area."""
    corner = corners.permute(1, 2, 0).contiguous()
    own = normal.T.contiguous()
    edges = corner.roll(-1, dims=0) - corner
    lengths = edges.square().sum(dim=1).sqrt()
    outward = torch.linalg.cross(edges, own.expand_as(edges), dim=1) / (lengths + TINY)[:, None]
    theirs = own.index_select(1, neighbours(faces).T.reshape(-1)).reshape(3, 3, -1).transpose(0, 1)
    sine = (theirs * outward).sum(dim=1)
    # From the corner opposite, which is two further on, to the edge.
    heights = ((corner - corner.roll(-2, dims=0)) * outward).sum(dim=1)
    area = 0.5 * float((heights[0] * lengths[0]).mean())
    return Neighbourhood(
        outward=outward,
        heights=heights,
        cosine=(theirs * own).sum(dim=1),
        sine=torch.where(sine > FLAT, sine, 0.0),
        reach=(outward[:, None] * radii.permute(2, 1, 0)).sum(dim=2),
        area=area,
        thickness=thicknesses(corner.mean(dim=0), own, COLUMN * math.sqrt(area + TINY)),
    )


def neighbours(faces: Int64[Tensor, "f 3"]) -> Int64[Tensor, "f 3"]:
    """The face across each edge; the face itself where an edge does not have exactly two faces."""
    start, end = faces.reshape(-1), faces.roll(-1, dims=1).reshape(-1)
    names, order = torch.sort(torch.minimum(start, end) * (1 + faces.amax()) + torch.maximum(start, end), stable=True)
    same = names[1:] == names[:-1]
    none = same.new_zeros(1)
    pair = (same & ~torch.cat([none, same[:-1]]) & ~torch.cat([same[1:], none])).nonzero()[:, 0]
    first, second = order[pair], order[pair + 1]
    across = torch.arange(len(faces), device=faces.device).repeat_interleave(3)
    across[first], across[second] = second // 3, first // 3
    return across.reshape(-1, 3)


def _across(neighbourhood: Neighbourhood, mixing: Float[Tensor, "f k 2 2"]) -> Float[Tensor, "3 2 k f"]:
    """By edge: components along ``outward`` of both columns of the tangential factors."""
    along, other = mixing.permute(2, 3, 1, 0).contiguous()
    return neighbourhood.reach[:, 0, None, None] * along + neighbourhood.reach[:, 1, None, None] * other


def log_density(neighbourhood: Neighbourhood, variance: float, per_face: int, width: float, blur: float) -> float:
    """ln N of a rim of curvature 1: how many Gaussians overlap there. ``width`` is s.

    ``variance`` is that of the Gaussians along an edge's normal, averaged over edges, which stands for that along the
    rim.
    """
    per_root = (
        per_face / (neighbourhood.area + TINY) * math.sqrt(2.0 * math.pi * (variance + blur * blur) * 2.0 * width)
    )
    return math.log(per_root + TINY)


def _log_layers(
    neighbourhood: Neighbourhood, across: Float[Tensor, "3 2 k f"], per_face: int, width: float, blur: float
) -> Float[Tensor, " f"]:
    """ln N on a rim of each face's own curvature."""
    variance = float(across.square().sum(dim=1).mean())
    # Two centroids are about two thirds of a height apart, and the bend between two sides of a polygon round a circle
    # has a half whose tangent is half a side over the radius.
    curvature = (3.0 * neighbourhood.half_tangent / (neighbourhood.heights + TINY)).amax(dim=0).clamp(min=FLATTEST)
    return log_density(neighbourhood, variance, per_face, width, blur) - 0.5 * curvature.log()


def _interpolated(depths: Float[Tensor, " n"], log_layers: Float[Tensor, " f"]) -> Float[Tensor, " f"]:
    """Between the values of ``rim_depths``, of which the first and the last hold beyond them."""
    at = ((log_layers - LOG_LAYERS_FROM) / LOG_LAYERS_STEP).clamp(0.0, len(depths) - 1.001)
    low = at.floor()
    # Clamped as an integer, because a NaN becomes any number.
    index = low.long().clamp(0, len(depths) - 2)
    return torch.lerp(depths[index], depths[index + 1], at - low)


def _trims(
    neighbourhood: Neighbourhood, across: Float[Tensor, "3 2 k f"], spread: Float[Tensor, "3 k f"]
) -> Float[Tensor, "f k 2 2"]:
    """Matrices C that make covariances as small across bends as they must be.

    ``spread`` is the variance that they may add across the plane of each neighbour, seen edge-on. A bound on the
    variance v along the unit vector m is kept by C C^T = (I + c g g^T)^-1 with g = A^T m and c = 1 / bound - 1 / v; it
    changes nothing at right angles. Of several bounds the c add up, which keeps them all.
    """
    x, y = across.unbind(dim=1)
    variance = x * x + y * y + TINY
    bound = torch.maximum(spread / (neighbourhood.sine.square() + TINY)[:, None], NARROWEST**2 * variance)
    surplus = torch.where((neighbourhood.sine > 0.0)[:, None], (1.0 / bound - 1.0 / variance).clamp(min=0.0), 0.0)
    xx, xy, yy = (surplus * x * x).sum(dim=0), (surplus * x * y).sum(dim=0), (surplus * y * y).sum(dim=0)
    # The inverse transpose of the Cholesky factor of I + sum c g g^T.
    first = (1.0 + xx).sqrt()
    second = (1.0 + yy - (xy / first).square()).clamp(min=1.0).sqrt()
    entries = [1.0 / first, -xy / (first * first * second), torch.zeros_like(first), 1.0 / second]
    return torch.stack([entry.T for entry in entries], dim=2).unflatten(2, (2, 2))
