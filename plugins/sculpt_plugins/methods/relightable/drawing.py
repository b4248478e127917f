"""What Relightable 3D Gaussian learns from: colours, normals that fit the depths, materials under a light."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.depth_normals import normals_of_depths
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.methods.relightable.config import RelightableConfig
from sculpt_plugins.methods.relightable.shading import LIGHT_DEGREE, encode_srgb, shade, unit

_COVERED = 0.5
"""Opacity of a pixel from which on it has a depth."""
_WHITE = 2 * math.sqrt(math.pi)
"""Of the constant harmonic, for a radiance of 1 from everywhere."""
_LEAST_SPREAD = 1e-6
"""Squared object units: below it the root of a variance has no slope to use (program)."""
_GROWTH = 6.0
"""Powers of ten by which the term of the spread would grow until materials begin; it stays at two (program)."""
_VISIBLE = 0.9
"""Share of the light that arrives, to begin with."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """Sums of weight times value."""

    rgb: Float[Tensor, "h w 3"]
    shaded: Float[Tensor, "h w 3"] | None
    """By materials and light."""
    alpha: Float[Tensor, "h w"]
    depth: Float[Tensor, "h w"]
    squared_depth: Float[Tensor, "h w"]
    normal: Float[Tensor, "h w 3"]
    """In the frame of the Gaussians."""


class RelightableDrawing(Drawing):
    """Pictures are drawn by the harmonics of 3DGS; materials explain the same pictures beside them."""

    def __init__(self, config: RelightableConfig, rasterizer: Rasterizer, device: torch.device):
        self._config, self._rasterizer = config, rasterizer
        light = torch.zeros((LIGHT_DEGREE + 1) ** 2, 3, device=device)
        light[0] = _WHITE
        self.light = nn.Parameter(light)

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return self._rasterizer.render(gaussians, camera, background, low_pass_px2=self._config.low_pass_px2)

    # -- what is learned beside 3DGS -----------------------------------------------------------------------------

    def own_rates(self) -> Mapping[str, float]:
        rates = self._config.material_rates
        return {
            "normals": rates.normals,
            "albedo": rates.albedo,
            "roughness": rates.roughness,
            "visibility": rates.visibility,
        }

    def own_values(self, gaussians: Gaussians) -> Mapping[str, Tensor]:
        """Normals along the thinnest axes, away from the middle of the box; grey, half rough."""
        thinnest = gaussians.rotations[:, :, 0]
        inward = (thinnest * gaussians.means).sum(dim=1, keepdim=True) < 0
        zero = torch.zeros_like(gaussians.opacities)
        return {
            "normals": torch.where(inward, -thinnest, thinnest),
            "albedo": torch.zeros_like(gaussians.means),
            "roughness": zero,
            "visibility": torch.full_like(zero, _VISIBLE).logit(),
        }

    def parameter_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=[self.light], rate=self._config.material_rates.light)]

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        config, camera = self._config, lesson.camera
        materials = lesson.progress >= config.materials_from and config.shaded > 0
        drawn = self._draw(gaussians, lesson, materials=materials)
        terms = {"color": l1_dssim(drawn.rgb, lesson.target.rgb, config.dssim)}
        covered = drawn.alpha.detach() > _COVERED
        depth, spread = mean_and_variance(drawn.depth, drawn.squared_depth, drawn.alpha, covered)
        if config.normal > 0:
            terms["normal"] = config.normal * normal_difference(drawn.normal, depth.detach(), camera)
        if config.spread > 0:
            alone = lesson.progress / config.materials_from if config.materials_from > 0 else 1.0
            growth = 10 ** min(_GROWTH * alone, 2.0)
            terms["spread"] = config.spread * growth * spread.clamp(min=_LEAST_SPREAD).sqrt().mean()
        if config.mask > 0 and lesson.target.alpha is not None:
            alpha = drawn.alpha.clamp(1e-4, 1 - 1e-4)
            terms["mask"] = config.mask * functional.binary_cross_entropy(alpha, lesson.target.alpha)
        if drawn.shaded is not None:
            terms["shaded"] = config.shaded * l1_dssim(drawn.shaded, lesson.target.rgb, config.dssim)
            grey = self.light.mean(dim=1, keepdim=True)
            terms["white"] = config.white * (self.light - grey).abs().mean()
        return terms

    def _draw(self, gaussians: Gaussians, lesson: Lesson, *, materials: bool) -> Drawn:
        camera, background = lesson.camera, lesson.background
        normals = unit(lesson.own["normals"])
        pose = camera.world_to_camera.to(gaussians.means)
        ahead = gaussians.means @ pose[2, :3] + pose[2, 3]
        colors = sh_to_rgb(gaussians.sh, gaussians.means, camera.position.to(normals))
        features, behind = [normals, ahead.square()[:, None], colors], [background.new_zeros(4), background]
        if materials:
            # Shading is to be explained by materials, not by other normals (program).
            features.append(self._shaded(gaussians, normals.detach(), lesson))
            behind.append(background)
        out = self._rasterizer.rasterize(
            gaussians.means,
            gaussians.scales,
            gaussians.rotations,
            gaussians.opacities,
            torch.cat(features, dim=1),
            camera,
            torch.cat(behind),
            low_pass_px2=self._config.low_pass_px2,
            alpha_max=0.999,
        )
        return Drawn(
            rgb=out.features[..., 4:7],
            shaded=out.features[..., 7:10] if materials else None,
            alpha=out.alpha,
            depth=out.depth,
            squared_depth=out.features[..., 3],
            normal=out.features[..., :3],
        )

    def _shaded(self, gaussians: Gaussians, normals: Float[Tensor, "g 3"], lesson: Lesson) -> Float[Tensor, "g 3"]:
        """sRGB of each Gaussian, as its material and the light make it (paper: shading before splatting)."""
        own = lesson.own
        linear = shade(
            normals,
            unit(lesson.camera.position.to(normals) - gaussians.means),
            own["albedo"].sigmoid(),
            own["roughness"].sigmoid(),
            own["visibility"].sigmoid(),
            self.light,
        )
        return encode_srgb(linear)


def normal_difference(normal: Float[Tensor, "h w 3"], depth: Float[Tensor, "h w"], camera: Camera) -> Float[Tensor, ""]:
    """Mean over the image and the axes of (N - N_d)^2, N_d of the depths; 0 where a depth of 0 says that
    nothing is.

    ``normal`` is in the frame that the camera is in.
    """
    own = normal @ camera.world_to_camera[:3, :3].T.to(normal)
    wanted, counts = normals_of_depths(depth, depth.detach() > 0, camera)
    return torch.where(counts, (own[1:-1, 1:-1] - wanted).square().mean(dim=2), 0.0).mean()


def mean_and_variance(
    total: Float[Tensor, "*n"], squares: Float[Tensor, "*n"], alpha: Float[Tensor, "*n"], covered: Bool[Tensor, "*n"]
) -> tuple[Float[Tensor, "*n"], Float[Tensor, "*n"]]:
    """Of values, by the sums of weight, weight times value and weight times square; 0, without gradient, where not
    covered. Rounding can leave a variance a hair below 0."""
    weight = torch.where(covered, alpha, 1.0)
    mean = torch.where(covered, total / weight, 0.0)
    return mean, torch.where(covered, squares / weight - mean.square(), 0.0)
