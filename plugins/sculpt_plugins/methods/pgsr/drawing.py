"""What PGSR learns from: colours, flat Gaussians, and planes that agree within and between views."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.losses import TrainingImage
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.depth_normals import normals_of_depths
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.pgsr.config import PgsrConfig
from sculpt_plugins.methods.pgsr.planes import PlaneMaps, depths_of, match_planes

_COVERED = 0.5
"""Opacity of a pixel below which it is of no plane."""
_NEIGHBOURS = 8
"""Views, nearest first, of which one is taken to compare with (program)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    rendering: Rendering
    maps: PlaneMaps


class PlaneDrawing(Drawing):
    def __init__(self, config: PgsrConfig, rasterizer: Rasterizer):
        self._config, self._rasterizer = config, rasterizer
        self._images: Sequence[TrainingImage] = ()
        self._numbers: dict[str, int] = {}
        self._near: list[list[int]] = []

    def begin(self, images: Sequence[TrainingImage]) -> None:
        self._images = images
        self._numbers = {image.name: number for number, image in enumerate(images)}
        places = torch.stack([image.camera.position for image in images])
        apart = (places[:, None] - places).norm(dim=2)
        order = apart.fill_diagonal_(-1.0).argsort(dim=1, stable=True)
        self._near = order[:, 1 : _NEIGHBOURS + 1].tolist()

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return self._draw(gaussians, camera, background).rendering

    def _draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Drawn:
        """Depth is that at which rays meet the mean plane, where a pixel is covered: unbiased (paper, eq. 4)."""
        pose = camera.world_to_camera.to(gaussians.means)
        normals = gaussians.rotations[:, :, 0] @ pose[:3, :3].T
        local = gaussians.means @ pose[:3, :3].T + pose[:3, 3]
        distance = (normals * local).sum(dim=1, keepdim=True)
        side = torch.where(distance > 0, -1.0, 1.0)
        colors = sh_to_rgb(gaussians.sh, gaussians.means, camera.position.to(normals))
        out = self._rasterizer.rasterize(
            gaussians.means,
            gaussians.scales,
            gaussians.rotations,
            gaussians.opacities,
            torch.cat([colors, side * normals, side * distance], dim=1),
            camera,
            torch.cat([background, background.new_zeros(4)]),
            low_pass_px2=self._config.low_pass_px2,
            alpha_max=0.99,
        )
        maps = PlaneMaps(
            normal=out.features[..., 3:6], distance=out.features[..., 6], covered=out.alpha.detach() > _COVERED
        )
        depth = torch.where(maps.covered, depths_of(maps, camera) * out.alpha, out.depth)
        rendering = Rendering(rgb=out.features[..., :3], alpha=out.alpha, depth=depth, normal=out.features[..., 3:6])
        return Drawn(rendering=rendering, maps=maps)

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        config, drawn = self._config, self._draw(gaussians, lesson.camera, lesson.background)
        terms = {"color": l1_dssim(drawn.rendering.rgb, lesson.target.rgb, config.dssim)}
        if config.flatness > 0:
            # Their first column is along the smallest (paper, eq. 1).
            terms["flatness"] = config.flatness * gaussians.scales[:, 0].mean()
        if lesson.progress < config.planes_from:
            return terms
        image = self._images[self._numbers[lesson.target.name]]
        if config.single_view > 0:
            terms["single view"] = config.single_view * single_view(drawn.maps, lesson.camera, image.premultiplied)
        near = self._near[self._numbers[lesson.target.name]]
        if near and config.geometric + config.photometric > 0:
            other = self._images[near[int(torch.randint(len(near), (1,), generator=lesson.generator))]]
            with torch.no_grad():
                seen = self._draw(gaussians, other.camera, lesson.background)
            matched = match_planes(drawn.maps, image, seen.maps, other, config.samples, lesson.generator)
            terms["geometric"] = config.geometric * matched.missed
            terms["photometric"] = config.photometric * matched.unlike
        return terms


def single_view(maps: PlaneMaps, camera: Camera, rgb: Float[Tensor, "h w 3"]) -> Float[Tensor, ""]:
    """Mean over the image of (1 - |grad I|)^2 |N_d - N|_1, 0 where no plane is; |grad I| as a share of the largest
    (paper, eq. 6)."""
    grey = rgb.mean(dim=2)
    across, down = grey[1:-1, 2:] - grey[1:-1, :-2], grey[2:, 1:-1] - grey[:-2, 1:-1]
    slope = (across.square() + down.square()).sqrt()
    even = (1 - slope / slope.max().clamp(min=1e-6)).square()
    normal, counts = normals_of_depths(depths_of(maps, camera), maps.covered, camera)
    own = maps.normal[1:-1, 1:-1]
    squared = own.square().sum(dim=2, keepdim=True)
    own = own * torch.where(squared > 0, squared, 1.0).rsqrt()
    return torch.where(counts, even * (normal - own).abs().sum(dim=2), 0.0).mean()
