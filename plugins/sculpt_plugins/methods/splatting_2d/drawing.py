"""What 2DGS learns from: colours, and disks that lie on one surface (Huang et al. 2024, 5)."""

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.free_gaussians.surface_terms import normal_difference
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.splatting_2d.config import Splatting2dConfig
from sculpt_plugins.methods.splatting_2d.disks import draw_disks


class DiskDrawing(Drawing):
    def __init__(self, config: Splatting2dConfig):
        self._config = config

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        # What depths are for here is the mesh: the median is where the surface is, the mean is behind it.
        drawn = draw_disks(gaussians, camera, background)
        return replace(drawn.rendering, depth=drawn.median * drawn.rendering.alpha)

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        config, drawn = self._config, draw_disks(gaussians, lesson.camera, lesson.background)
        rendering = drawn.rendering
        terms = {"color": l1_dssim(rendering.rgb, lesson.target.rgb, config.dssim)}
        if config.distortion > 0 and lesson.progress >= config.distortion_from:
            terms["distortion"] = config.distortion * drawn.distortion.mean()
        if config.normals > 0 and lesson.progress >= config.normals_from:
            terms["normals"] = config.normals * normal_difference(rendering, lesson.camera)
        return terms
