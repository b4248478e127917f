"""What GOF learns from: colours, and Gaussians that lie on one surface (Yu et al. 2024)."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.free_gaussians.surface_terms import normal_difference
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.gof.config import GofConfig
from sculpt_plugins.methods.gof.rays import draw_rays


class RayDrawing(Drawing):
    def __init__(self, config: GofConfig):
        self._config = config

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return draw_rays(gaussians, camera, background, self._config.smoothing).rendering

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        config = self._config
        drawn = draw_rays(gaussians, lesson.camera, lesson.background, config.smoothing)
        terms = {"color": l1_dssim(drawn.rendering.rgb, lesson.target.rgb, config.dssim)}
        if config.distortion > 0 and lesson.progress >= config.distortion_from:
            terms["distortion"] = config.distortion * drawn.distortion.mean()
        if config.normals > 0 and lesson.progress >= config.normals_from:
            terms["normals"] = config.normals * normal_difference(drawn.rendering, lesson.camera)
        return terms
