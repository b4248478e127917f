"""What 2DGS learns from: colours, and disks that lie on one surface (Huang et al. 2024, 4.2)."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.rendering.depth_normals import normals_of_depths
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.splatting_2d.config import Splatting2dConfig
from sculpt_plugins.methods.splatting_2d.disks import draw_disks

_COVERED = 0.5
"""Opacity of a pixel below which its depth tells of no surface."""


class DiskDrawing(Drawing):
    def __init__(self, config: Splatting2dConfig):
        self._config = config

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return draw_disks(gaussians, camera, background).rendering

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        config, drawn = self._config, draw_disks(gaussians, lesson.camera, lesson.background)
        rendering = drawn.rendering
        terms = {"color": l1_dssim(rendering.rgb, lesson.target.rgb, config.dssim)}
        if config.distortion > 0 and lesson.progress >= config.distortion_from:
            terms["distortion"] = config.distortion * drawn.distortion.mean()
        if config.normals > 0 and lesson.progress >= config.normals_from:
            terms["normals"] = config.normals * normal_difference(rendering, lesson.camera)
        return terms


def normal_difference(rendering: Rendering, camera: Camera) -> Float[Tensor, ""]:
    """Mean over the pixels of sum_i w_i (1 - n_i . N), N the normal of the mean depth's surface (paper, eq. 14).

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
