"""Gaussians on the screen: EWA splatting (Zwicker et al. 2001) with the conventions of 3DGS, in plain torch."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.types import Camera

JACOBIAN_MARGIN = 0.3
"""How far outside the image the projection is still linearised where it is, in half fields of view."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScreenGaussians:
    """Projected Gaussians. Positions in pixels (column, row), the first pixel's centre at 0.5."""

    means: Float[Tensor, "g 2"]
    depths: Float[Tensor, " g"]
    """Camera z."""
    covariances: Float[Tensor, "g 3"]
    """xx, xy, yy in square pixels, low-pass included."""
    conics: Float[Tensor, "g 3"]
    """xx, xy, yy of the inverse covariance."""


def project(
    means: Float[Tensor, "g 3"],
    scales: Float[Tensor, "g 3"],
    rotations: Float[Tensor, "g 3 3"],
    camera: Camera,
    low_pass_px2: float,
) -> ScreenGaussians:
    """Means by perspective, covariances by its Jacobian at the mean; differentiable in everything.

    The Jacobian is taken no further outside the image than ``JACOBIAN_MARGIN`` half fields of view (a centred camera:
    1.3 times the half field of view, as 3DGS), and has no gradient by the direction there. Where camera z is zero the
    result is not finite: leave such Gaussians out beforehand.
    """
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    x, y, z = (means @ rotation.T + translation).unbind(dim=1)
    along_x, along_y = x / z, y / z
    margin_x = JACOBIAN_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = JACOBIAN_MARGIN * 0.5 * camera.height / camera.fy
    at_x = along_x.clamp(-camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    at_y = along_y.clamp(-camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)

    # The two rows of J W, then of J W R diag(scales): the covariance is their Gram matrix.
    to_column = (camera.fx / z)[:, None] * (rotation[0] - at_x[:, None] * rotation[2])
    to_row = (camera.fy / z)[:, None] * (rotation[1] - at_y[:, None] * rotation[2])
    a = torch.einsum("gi,gij->gj", to_column, rotations) * scales
    b = torch.einsum("gi,gij->gj", to_row, rotations) * scales
    aa, ab, bb = (a * a).sum(dim=1), (a * b).sum(dim=1), (b * b).sum(dim=1)
    # det(Gram + h I) by Cauchy-Binet: a sum of squares, where aa bb - ab^2 would cancel for slivers.
    parallelogram = torch.linalg.cross(a, b).square().sum(dim=1)
    determinant = parallelogram + low_pass_px2 * (aa + bb) + low_pass_px2 * low_pass_px2
    xx, yy = aa + low_pass_px2, bb + low_pass_px2
    return ScreenGaussians(
        means=torch.stack([camera.fx * along_x + camera.cx, camera.fy * along_y + camera.cy], dim=1),
        depths=z,
        covariances=torch.stack([xx, ab, yy], dim=1),
        conics=torch.stack([yy, -ab, xx], dim=1) / determinant[:, None],
    )
