"""Gaussians drawn with normals that face the camera."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms, facing
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, Rendering


class FacingSplatting(Drawing):
    """By a rasterizer, as ellipsoids; the normal of each is its thinnest axis, on the side of the camera."""

    def __init__(self, rasterizer: Rasterizer, low_pass_px2: float, dssim: float):
        self._rasterizer, self._low_pass, self._dssim = rasterizer, low_pass_px2, dssim

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        colors = sh_to_rgb(gaussians.sh, gaussians.means, camera.position)
        out = self._rasterizer.rasterize(
            gaussians.means,
            gaussians.scales,
            gaussians.rotations,
            gaussians.opacities,
            torch.cat([colors, facing(gaussians.rotations[:, :, 0], gaussians.means, camera)], dim=1),
            camera,
            torch.cat([background, torch.zeros_like(background)]),
            low_pass_px2=self._low_pass,
            alpha_max=0.999,
        )
        return Rendering(rgb=out.features[..., :3], alpha=out.alpha, depth=out.depth, normal=out.features[..., 3:])

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        return self.color_terms(self.draw(gaussians, lesson.camera, lesson.background), lesson)

    def color_terms(self, rendering: Rendering, lesson: Lesson) -> Terms:
        return {"color": l1_dssim(rendering.rgb, lesson.target.rgb, self._dssim)}
