"""What methods whose Gaussians lie on a surface learn besides colours."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.rendering.depth_normals import normals_of_depths
from sculpt_framework.types import Camera, Rendering

_COVERED = 0.5
"""Opacity of a pixel below which its depth tells of no surface."""


def normal_difference(rendering: Rendering, camera: Camera) -> Float[Tensor, ""]:
    """Mean over the pixels of sum_i w_i (1 - n_i . N), N the normal of the mean depth's surface (2DGS, eq. 14).

    N is by central differences; it counts where the pixel and its four neighbours are covered.
    """
    assert rendering.normal is not None  # noqa: S101
    covered = rendering.alpha.detach() > _COVERED
    depth = rendering.depth / torch.where(covered, rendering.alpha, 1.0)
    normal, counts = normals_of_depths(depth, covered, camera)
    facing = normal @ camera.world_to_camera[:3, :3].to(normal)
    counts = counts & covered[1:-1, 1:-1]
    inner, alpha = rendering.normal[1:-1, 1:-1], rendering.alpha[1:-1, 1:-1]
    return torch.where(counts, alpha - (inner * facing).sum(dim=2), 0.0).mean()
