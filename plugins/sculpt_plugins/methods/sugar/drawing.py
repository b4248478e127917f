"""What SuGaR learns from: colours, opacities of 0 or 1, and Gaussians that lie on one surface (4.1)."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.sugar.config import SugarConfig
from sculpt_plugins.methods.sugar.density import density_at, implied, neighbours

_COVERED = 0.5
"""Opacity of a pixel from which on its depth tells of a surface."""
_CLOSE = 2.0
"""Standard deviations, along the line of sight, within which of the depth a Gaussian is of what is seen (program)."""
_NEAREST = 1e-2
"""Object units in front of the camera."""
_MARGIN = 1e-6
"""Opacities nearer to 0 or 1 have an entropy without gradient."""


class SurfaceDrawing(Drawing):
    def __init__(self, config: SugarConfig, rasterizer: Rasterizer):
        self._config, self._rasterizer = config, rasterizer

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return self._rasterizer.render(gaussians, camera, background, low_pass_px2=self._config.low_pass_px2)

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        config, rendering = self._config, self.draw(gaussians, lesson.camera, lesson.background)
        terms = {"color": l1_dssim(rendering.rgb, lesson.target.rgb, config.dssim)}
        if config.entropy > 0 and config.entropy_from <= lesson.progress < config.surface_from:
            terms["entropy"] = config.entropy * entropy(gaussians.opacities)
        if config.distance + config.normals > 0 and lesson.progress >= config.surface_from:
            missed, off = surface_terms(gaussians, rendering, lesson.camera, config.samples, lesson.generator)
            terms["distance"], terms["normals"] = config.distance * missed, config.normals * off
        return terms


def entropy(opacities: Float[Tensor, " g"]) -> Float[Tensor, ""]:
    """Mean of -o log o - (1 - o) log (1 - o)."""
    held = opacities.clamp(_MARGIN, 1 - _MARGIN)
    return (torch.special.entr(held) + torch.special.entr(1 - held)).mean()


def surface_terms(
    gaussians: Gaussians, rendering: Rendering, camera: Camera, samples: int, generator: torch.Generator
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """(Mean of ||f^| - |f||, mean squared difference of normals): eq. 8 and 10, at points of Gaussians (eq. 9).

    f^ is the difference between the depth of a point and that of its pixel, which has no gradient. Points are drawn
    from Gaussians near what the view shows; those behind the camera, beside the image or before the background have
    no say. Both are 0, with gradients of 0, where none has.
    """
    with torch.no_grad():
        depth, in_image = _seen(gaussians.means, rendering, camera)
        away = (gaussians.means[:, None] - camera.position.to(gaussians.means))[:, 0]
        sight = torch.nn.functional.normalize(away, dim=1)
        reach = (torch.einsum("gij,gi->gj", gaussians.rotations, sight) * gaussians.scales).norm(dim=1)
        chosen = (in_image & (depth.abs() < _CLOSE * reach)).nonzero()[:, 0]
    nothing = gaussians.means.sum() * 0.0
    if len(chosen) == 0:
        return nothing, nothing
    with torch.no_grad():
        rows = chosen[torch.randint(len(chosen), (samples,), generator=generator).to(chosen.device)]
        noise = torch.randn(samples, 3, generator=generator).to(gaussians.means)
        offsets = torch.einsum("nij,nj->ni", gaussians.rotations[rows], noise * gaussians.scales[rows])
        points = gaussians.means[rows] + offsets
        ideal, in_image = _seen(points, rendering, camera)
        near = neighbours(gaussians, points)
    found = implied(gaussians, density_at(gaussians, points, near))
    counts = found.known & in_image
    number = counts.sum().clamp(min=1)
    missed = torch.where(counts, (ideal.abs() - found.distance).abs(), 0.0).sum() / number
    return missed, torch.where(counts, found.off, 0.0).sum() / number


def _seen(
    points: Float[Tensor, "n 3"], rendering: Rendering, camera: Camera
) -> tuple[Float[Tensor, " n"], "torch.Tensor"]:
    """How far points are before the depth of their pixel, and which of them are before one that has a depth."""
    pose = camera.world_to_camera.to(points)
    local = points @ pose[:3, :3].T + pose[:3, 3]
    ahead = local[:, 2] > _NEAREST
    z = torch.where(ahead, local[:, 2], 1.0)
    size = points.new_tensor([camera.width, camera.height])
    places = torch.stack([local[:, 0] / z * camera.fx + camera.cx, local[:, 1] / z * camera.fy + camera.cy], dim=1)
    inside = ahead & ((places >= 0) & (places < size)).all(dim=1)
    column, row = torch.where(inside[:, None], places, 0.0).long().unbind(dim=1)
    alpha = rendering.alpha[row, column]
    covered = inside & (alpha > _COVERED)
    return rendering.depth[row, column] / torch.where(covered, alpha, 1.0) - z, covered
