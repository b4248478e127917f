"""Binding in plain torch: any device and floating-point type, and the measure of the kernels."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binding
from sculpt_framework.types import Surface
from sculpt_plugins.binders.face_barycentric.limits import SQUARE
from sculpt_plugins.binders.face_barycentric.outline import Neighbourhood, fit_outline


@dataclass(frozen=True, kw_only=True, eq=False)
class BindOptions:
    """How Gaussians are bound, beside faces and rows."""

    reference: str
    """``steiner`` or ``edges``."""
    normal_scale: float
    """Standard deviation along the normal, in object units."""
    blur: float
    """Standard deviation of the screen's filter, in object units."""
    neighbourhood: Neighbourhood | None
    """Of the surface, if outlines are fitted."""
    depths: Float[Tensor, " n"]
    """``outline.rim_depths`` of the opacity."""

    @property
    def least_parallelogram(self) -> float:
        """Twice the area from which on a face's normal has its exact gradient; that of a smaller face is as of one so
        large.

        No image shows which way a face looks that is smaller than its Gaussian is thick. The surface has such faces
        where it passes through a corner of the grid; exact gradients of one of them would outweigh all others.
        """
        return self.normal_scale**2


def bind_in_torch(
    surface: Surface, rows: Mapping[str, Tensor], opacities: Float[Tensor, "f k"], options: BindOptions
) -> Binding:
    """Differentiable in vertices and rows; what the outline's fit does is a constant of the step."""
    # Not by indexing: the order in which its backward adds on a CPU changes from run to run.
    corners = surface.vertices.index_select(0, surface.faces.reshape(-1)).reshape(-1, 3, 3)
    barycentrics = rows["barycentric_logits"].softmax(dim=2)
    normal, radii = normal_and_radii(corners, options.reference, options.least_parallelogram)
    means = barycentrics @ corners
    mixing = _mixing(rows["log_ratios"].exp(), rows.get("rotation"))
    if options.neighbourhood is not None:
        # Neither faces nor rows get a gradient through the fit.
        fit = fit_outline(
            options.neighbourhood,
            barycentrics.detach(),
            mixing.detach(),
            options.depths.to(corners),
            blur=options.blur,
            normal_scale=options.normal_scale,
        )
        means = means - fit.depth[:, None, None] * normal[:, None] + fit.shift
        mixing = mixing @ fit.trim
    factor = radii[:, None] @ mixing
    length = (factor.square().sum(dim=2) + SQUARE).sqrt()
    normals = normal[:, None, :, None].expand(-1, opacities.shape[1], -1, -1)
    flat = torch.full_like(length[..., :1], options.normal_scale)
    flat_corners, flat_radii = _in_plane(corners, normal, options.reference)
    covariance_factor = flat_radii[:, None] @ mixing
    return Binding(
        means=means,
        scales=torch.cat([flat, length], dim=2),
        rotations=torch.cat([normals, factor / length[:, :, None]], dim=3),
        opacities=opacities,
        barycentrics=barycentrics,
        tangent_covariance=covariance_factor @ covariance_factor.transpose(2, 3),
        tangent_corners=flat_corners,
    )


def normal_and_radii(
    corners: Float[Tensor, "f 3 3"], reference: str, least: float = 0.0
) -> tuple[Float[Tensor, "f 3"], Float[Tensor, "f 3 2"]]:
    """Unit normals, and both reference radii as columns. ``least``: ``BindOptions.least_parallelogram``."""
    first, second, third = corners.unbind(1)
    edge, other = second - first, third - first
    upward = torch.cross(edge, other, dim=1)
    normal = _unit(upward)
    if least > 0.0:
        share = (_rounded_length(upward.detach()) / least).clamp(max=1.0)
        normal = normal.detach() + share * (normal - normal.detach())
    if reference == "steiner":
        along, across = edge / math.sqrt(3.0), (2.0 / 3.0) * (third - 0.5 * (first + second))
    else:
        along = 0.5 * edge
        across = 0.5 * _length(other)[:, None] * torch.cross(normal, _unit(edge), dim=1)
    return normal, torch.stack([along, across], dim=2)


def _mixing(ratios: Float[Tensor, "f k 2"], angle: Float[Tensor, "f k"] | None) -> Float[Tensor, "f k 2 2"]:
    """What makes tangential columns of the reference radii: the ratios, turned in the whitened plane."""
    if angle is None:
        return torch.diag_embed(ratios)
    cos, sin = angle.cos(), angle.sin()
    first, second = ratios.unbind(dim=2)
    return torch.stack([cos * first, -sin * second, sin * first, cos * second], dim=2).unflatten(2, (2, 2))


def _unit(vector: Float[Tensor, "f 3"]) -> Float[Tensor, "f 3"]:
    """Direction of a vector; shorter than 1 for vectors that are hardly longer than rounding."""
    return vector / _rounded_length(vector)


def _rounded_length(vector: Float[Tensor, "f 3"]) -> Float[Tensor, "f 1"]:
    return (vector.square().sum(dim=-1, keepdim=True) + SQUARE * SQUARE).sqrt()


def _in_plane(
    corners: Float[Tensor, "f 3 3"], normal: Float[Tensor, "f 3"], reference: str
) -> tuple[Float[Tensor, "f 3 2"], Float[Tensor, "f 2 2"]]:
    """Corners, relative to their mean, and reference radii in the face's frame: r1 along the first edge and
    r2 = normal x r1 (paper, 3.1)."""
    first, second, third = corners.unbind(1)
    edge, other = second - first, third - first
    r1 = _unit(edge)
    x = (edge * r1).sum(dim=1)
    p, q = (other * r1).sum(dim=1), (other * torch.cross(normal, r1, dim=1)).sum(dim=1)
    flat = torch.stack([-x - p, -q, 2.0 * x - p, -q, 2.0 * p - x, 2.0 * q], dim=1) / 3.0
    zero = torch.zeros_like(x)
    if reference == "steiner":
        radii = [x / math.sqrt(3.0), (2.0 * p - x) / 3.0, zero, (2.0 / 3.0) * q]
    else:
        radii = [0.5 * x, zero, zero, 0.5 * _length(other)]
    return flat.unflatten(1, (3, 2)), torch.stack(radii, dim=1).unflatten(1, (2, 2))


def _length(vector: Float[Tensor, "f 3"]) -> Float[Tensor, " f"]:
    """Rounded off at the shortest length that is told from zero."""
    return (vector.square().sum(dim=1) + SQUARE).sqrt()
