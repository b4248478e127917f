"""Slot ``rasterizer``: Gaussians and a camera in, an image out, differentiable in both."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, Rendering


@dataclass(frozen=True, kw_only=True, eq=False)
class RasterOutput:
    features: Float[Tensor, "h w c"]
    alpha: Float[Tensor, "h w"]
    depth: Float[Tensor, "h w"]


class Rasterizer(ABC):
    """EWA splatting, front to back, of any number of feature channels.

    All backends do the same arithmetic, so that each can be compared with ``reference``:

    - A Gaussian with camera z below ``NEAR`` is not drawn, nor one with opacity below ``ALPHA_MIN``.
    - Its screen covariance is J W S W^T J^T + low_pass_px2 I, with J the projection's Jacobian at the mean, where
      x/z and y/z are clamped inside J to the image's field of view plus 0.3 half fields on each side (3DGS, for any
      principal point); the gradient is zero where clamped.
    - A Gaussian with a projected value that is not finite is not drawn and gets no gradient.
    - alpha = min(alpha_max, opacity exp(-d^T K d / 2)); contributions with alpha < ``ALPHA_MIN`` are skipped.
    - Sorted by camera z of the means (ties by index); a pixel stops once its transmittance is below
      ``TRANSMITTANCE_MIN`` before a splat: that splat and all behind it add nothing.
    - features = sum_i w_i f_i + (1 - alpha) background.
    """

    NEAR = 1e-2
    """Object units."""
    ALPHA_MIN = 1.0 / 255.0
    TRANSMITTANCE_MIN = 1e-4

    @abstractmethod
    def rasterize(
        self,
        means: Float[Tensor, "g 3"],
        scales: Float[Tensor, "g 3"],
        rotations: Float[Tensor, "g 3 3"],
        opacities: Float[Tensor, " g"],
        features: Float[Tensor, "g c"],
        camera: Camera,
        background: Float[Tensor, " c"] | Float[Tensor, "h w c"],
        *,
        low_pass_px2: float,
        alpha_max: float,
    ) -> RasterOutput:
        """Gradients reach every tensor argument but the background, ``camera.world_to_camera`` included."""

    def draw_one(self, device: torch.device) -> None:
        """One Gaussian: kernels are compiled when they are first used, and what that takes may be missing."""
        one = torch.ones(1, device=device)
        pose = torch.eye(4, device=device)
        pose[2, 3] = 2.0
        camera = Camera(world_to_camera=pose, fx=4.0, fy=4.0, cx=2.0, cy=2.0, width=4, height=4)
        self.rasterize(
            torch.zeros(1, 3, device=device), one.expand(1, 3), torch.eye(3, device=device)[None], 0.5 * one,
            one[:, None], camera, 0.0 * one, low_pass_px2=0.3, alpha_max=0.999,
        )  # fmt: skip

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: Float[Tensor, " 3"] | Float[Tensor, "h w 3"],
        *,
        low_pass_px2: float,
        alpha_max: float = 0.999,
        normals: bool = False,
    ) -> Rendering:
        """Colours from spherical harmonics, then ``rasterize``; ``normals`` adds the normal image at a cost."""
        features = sh_to_rgb(gaussians.sh, gaussians.means, camera.position)
        if normals:
            features = torch.cat([features, gaussians.rotations[:, :, 0]], dim=1)
            background = torch.cat([background, torch.zeros_like(background)], dim=-1)
        out = self.rasterize(
            gaussians.means,
            gaussians.scales,
            gaussians.rotations,
            gaussians.opacities,
            features,
            camera,
            background,
            low_pass_px2=low_pass_px2,
            alpha_max=alpha_max,
        )
        return Rendering(
            rgb=out.features[..., :3],
            alpha=out.alpha,
            depth=out.depth,
            normal=out.features[..., 3:] if normals else None,
        )
