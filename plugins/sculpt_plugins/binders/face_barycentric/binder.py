"""Gaussians at learnable barycentric coordinates of faces (paper, 3.1, equations 1 and 2)."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binder, Binding
from sculpt_framework.types import Surface
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.binders.face_barycentric.outline import Fit, Relief, fit_outline, relief_of, rim_depths
from sculpt_plugins.binders.face_barycentric.placement import placement

_TINY = 1e-12
"""Square of the shortest length that is told from zero, in object units squared."""


class FaceBarycentricBinder(Binder):
    """m = sum_i alpha_i v_i with alpha = softmax of logits: non-negative and summing to one by construction.

    Reference radii of the tangential scales, which the rows' ratios multiply:

    ``edges``    the paper's s1 = |v2 - v1| / 2 along r1 and s2 = |v3 - v1| / 2 along r2 (orthonormal).
    ``steiner``  conjugate radii of the Steiner circumellipse, M = (2/3) sum_i (v_i - c)(v_i - c)^T
                 = a a^T + b b^T with a = (v2 - v1) / sqrt(3) and b = (2/3) (v3 - (v1 + v2) / 2). Smooth in the
                 vertices, independent of their order, and flat where the face is flat. a and b are not orthogonal in
                 general: the tangential columns of ``rotations`` are unit vectors, but conjugate ones. In them the
                 scale constraint is exact: the eigenvalues of M^-1 Sigma are the squared ratios.

    With ``fit_outline`` Gaussians are moved and trimmed as ``outline.py`` says; their barycentrics stay those of the
    place on the face. A face of no area binds finite Gaussians with finite gradients: lengths are rounded off at 1e-6
    object units.
    """

    def __init__(self, config: FaceBarycentricConfig):
        if not 0 < config.theta < 1:
            raise ValueError(f"theta must lie between 0 and 1, not {config.theta}")
        self._config = config
        self._placement = placement(config.gaussians_per_face)
        self._latest: tuple[Surface, Relief] | None = None
        self._rim_depths = torch.from_numpy(rim_depths(config.theta))

    @property
    def gaussians_per_face(self) -> int:
        return self._config.gaussians_per_face

    @property
    def learning_rates(self) -> dict[str, float]:
        rates = {"log_ratios": self._config.scale_rate}
        # With K = 1 every barycentric weight is a fair choice, with more they are what the distribution losses act on.
        rates["barycentric_logits"] = self._config.barycentric_rate
        if self._config.rotation_rate > 0:
            rates["rotation"] = self._config.rotation_rate
        if self._config.opacity == "learnable":
            rates["opacity_logits"] = self._config.opacity_rate
        return rates

    def new_rows(self, faces: int, device: torch.device, dtype: torch.dtype) -> dict[str, Tensor]:
        k = self.gaussians_per_face
        logits = self._placement.log().to(device=device, dtype=dtype)
        # K Gaussians share the Steiner ellipse's area, so that as many of them overlap whatever K is.
        ratio = math.log(self._config.scale) - (0.5 * math.log(k) if self._config.reference == "steiner" else 0.0)
        rows = {
            "log_ratios": torch.full((faces, k, 2), ratio, device=device, dtype=dtype),
            "barycentric_logits": logits.expand(faces, k, 3).clone(),
        }
        if self._config.rotation_rate > 0:
            rows["rotation"] = torch.zeros(faces, k, device=device, dtype=dtype)
        if self._config.opacity == "learnable":
            theta = math.log(self._config.theta / (1 - self._config.theta))
            rows["opacity_logits"] = torch.full((faces, k), theta, device=device, dtype=dtype)
        return rows

    def bind(self, surface: Surface, rows: Mapping[str, Tensor], *, blur: float) -> Binding:
        # Not by indexing: the order in which its backward adds on a CPU changes from run to run.
        corners = surface.vertices.index_select(0, surface.faces.reshape(-1)).reshape(-1, 3, 3)
        barycentrics = rows["barycentric_logits"].softmax(dim=2)
        normal, radii = _normal_and_radii(corners, self._config.reference)
        means = barycentrics @ corners
        mixing = _mixing(rows["log_ratios"].exp(), rows.get("rotation"))
        if self._config.fit_outline:
            fit = self._fit(surface, corners, normal, radii, barycentrics, mixing, blur)
            means = means - fit.depth[:, None, None] * normal[:, None] + fit.shift
            mixing = mixing @ fit.trim
        factor = radii[:, None] @ mixing
        length = (factor.square().sum(dim=2) + _TINY).sqrt()
        normals = normal[:, None, :, None].expand(-1, self.gaussians_per_face, -1, -1)
        flat = torch.full_like(length[..., :1], self._config.normal_scale)
        flat_corners, flat_radii = _in_plane(corners, normal, self._config.reference)
        covariance_factor = flat_radii[:, None] @ mixing
        if "opacity_logits" in rows:
            opacities = rows["opacity_logits"].sigmoid()
        else:
            opacities = torch.full_like(length[..., 0], self._config.theta)
        return Binding(
            means=means,
            scales=torch.cat([flat, length], dim=2),
            rotations=torch.cat([normals, factor / length[:, :, None]], dim=3),
            opacities=opacities,
            barycentrics=barycentrics,
            tangent_covariance=covariance_factor @ covariance_factor.transpose(2, 3),
            tangent_corners=flat_corners,
        )

    def _fit(
        self,
        surface: Surface,
        corners: Float[Tensor, "f 3 3"],
        normal: Float[Tensor, "f 3"],
        radii: Float[Tensor, "f 3 2"],
        barycentrics: Float[Tensor, "f k 3"],
        mixing: Float[Tensor, "f k 2 2"],
        blur: float,
    ) -> Fit:
        """Constants of this step: neither faces nor rows get a gradient through them."""
        return fit_outline(
            self._relief_of(surface.detach(), corners.detach(), normal.detach(), radii.detach()),
            barycentrics.detach(),
            mixing.detach(),
            self._rim_depths.to(corners),
            blur=blur,
            normal_scale=self._config.normal_scale,
        )

    def _relief_of(
        self,
        surface: Surface,
        corners: Float[Tensor, "f 3 3"],
        normal: Float[Tensor, "f 3"],
        radii: Float[Tensor, "f 3 2"],
    ) -> Relief:
        """That of the surface asked for last is kept: an inner loop binds to one surface many times."""
        if self._latest is not None:
            known, relief = self._latest
            if torch.equal(known.faces, surface.faces) and torch.equal(known.vertices, surface.vertices):
                return relief
        relief = relief_of(surface.faces, corners, normal, radii)
        self._latest = (surface, relief)
        return relief


def _mixing(ratios: Float[Tensor, "f k 2"], angle: Float[Tensor, "f k"] | None) -> Float[Tensor, "f k 2 2"]:
    """What makes tangential columns of the reference radii: the ratios, turned in the whitened plane."""
    if angle is None:
        return torch.diag_embed(ratios)
    cos, sin = angle.cos(), angle.sin()
    first, second = ratios.unbind(dim=2)
    return torch.stack([cos * first, -sin * second, sin * first, cos * second], dim=2).unflatten(2, (2, 2))


def _unit(vector: Float[Tensor, "f 3"]) -> Float[Tensor, "f 3"]:
    """Direction of a vector; shorter than 1 for vectors that are hardly longer than rounding."""
    return vector / (vector.square().sum(dim=-1, keepdim=True) + _TINY * _TINY).sqrt()


def _normal_and_radii(
    corners: Float[Tensor, "f 3 3"], reference: str
) -> tuple[Float[Tensor, "f 3"], Float[Tensor, "f 3 2"]]:
    first, second, third = corners.unbind(1)
    edge, other = second - first, third - first
    normal = _unit(torch.cross(edge, other, dim=1))
    if reference == "steiner":
        along, across = edge / math.sqrt(3.0), (2.0 / 3.0) * (third - 0.5 * (first + second))
    else:
        along = 0.5 * edge
        across = 0.5 * _length(other)[:, None] * torch.cross(normal, _unit(edge), dim=1)
    return normal, torch.stack([along, across], dim=2)


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
    return (vector.square().sum(dim=1) + _TINY).sqrt()
