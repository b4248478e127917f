"""Gaussians at learnable barycentric coordinates of faces (paper, 3.1, equations 1 and 2)."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binder, Binding
from sculpt_framework.types import Surface
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
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

    A face of no area binds finite Gaussians with finite gradients: lengths are rounded off at 1e-6 object units.
    """

    def __init__(self, config: FaceBarycentricConfig):
        if not 0 < config.theta < 1:
            raise ValueError(f"theta must lie between 0 and 1, not {config.theta}")
        self._config = config
        self._placement = placement(config.gaussians_per_face)

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
        ratio = math.log(self._config.scale)
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
        means = barycentrics @ corners - self._config.inset * blur * normal[:, None]
        ratios = rows["log_ratios"].exp()
        mixed = radii[:, None].expand(-1, self.gaussians_per_face, -1, -1)
        whitened = torch.diag_embed(ratios)
        if "rotation" in rows:
            turn = _rotation(rows["rotation"])
            mixed, whitened = mixed @ turn, turn @ whitened
        length = (mixed.square().sum(dim=2) + _TINY).sqrt()
        directions = mixed / length[:, :, None]
        normals = normal[:, None, :, None].expand(-1, self.gaussians_per_face, -1, -1)
        flat = torch.full_like(length[..., :1], self._config.normal_scale)
        frame = _tangent_frame(corners, normal)
        in_plane = frame.transpose(1, 2) @ radii
        covariance_factor = in_plane[:, None] @ whitened
        if "opacity_logits" in rows:
            opacities = rows["opacity_logits"].sigmoid()
        else:
            opacities = torch.full_like(length[..., 0], self._config.theta)
        centred = corners - corners.mean(dim=1, keepdim=True)
        return Binding(
            means=means,
            scales=torch.cat([flat, ratios * length], dim=2),
            rotations=torch.cat([normals, directions], dim=3),
            opacities=opacities,
            barycentrics=barycentrics,
            tangent_covariance=covariance_factor @ covariance_factor.transpose(2, 3),
            tangent_corners=centred @ frame,
        )


def _rotation(angle: Float[Tensor, "f k"]) -> Float[Tensor, "f k 2 2"]:
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([torch.stack([cos, -sin], dim=-1), torch.stack([sin, cos], dim=-1)], dim=-2)


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
        r1 = _unit(edge)
        along = 0.5 * edge
        across = 0.5 * torch.cross(normal, r1, dim=1) * (other.square().sum(dim=1, keepdim=True) + _TINY).sqrt()
    return normal, torch.stack([along, across], dim=2)


def _tangent_frame(corners: Float[Tensor, "f 3 3"], normal: Float[Tensor, "f 3"]) -> Float[Tensor, "f 3 2"]:
    """r1 along the first edge and r2 = normal x r1 (paper, 3.1)."""
    r1 = _unit(corners[:, 1] - corners[:, 0])
    return torch.stack([r1, torch.cross(normal, r1, dim=1)], dim=2)
