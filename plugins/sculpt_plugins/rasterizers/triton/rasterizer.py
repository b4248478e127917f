"""The CUDA rasteriser: the framework's contract on top of the kernels."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.rendering.projection import JACOBIAN_MARGIN
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.triton import layout
from sculpt_plugins.rasterizers.triton.splatting import Screen, splat

_LARGEST_IMAGE = 16384


class TritonRasterizer(Rasterizer):
    """float32 on a CUDA device. Repeated runs give the same bits, gradients included: nothing is added up atomically.

    A Gaussian of which any projected value, opacity or feature is not finite (or beyond 1e18) is not drawn and gets
    zero gradients. From seven features upwards each further seven cost another pass over the whole.
    """

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
        """Raises TypeError for tensors of another type or device, ValueError for sizes and limits out of range."""
        pose = camera.world_to_camera
        named = {
            "means": means,
            "scales": scales,
            "rotations": rotations,
            "opacities": opacities,
            "features": features,
            "world_to_camera": pose,
            "background": background,
        }
        for name, tensor in named.items():
            if tensor.dtype != torch.float32 or tensor.device != means.device:
                raise TypeError(
                    f"rasterizer 'triton' takes float32 on one device, but {name} is {tensor.dtype} on {tensor.device} "
                    f"and means are on {means.device}: convert it, or use rasterizer 'reference'"
                )
        # Less than one in single precision, too.
        if not layout.ALPHA_MIN.value < alpha_max <= 1.0 - 2.0**-24:
            raise ValueError(f"alpha_max is {alpha_max}; it must lie between 1/255 and 1")
        if low_pass_px2 < 0.0:
            raise ValueError(f"low_pass_px2 is {low_pass_px2}; a variance is not negative")
        if features.shape[1] == 0:
            raise ValueError("features have no channels; at least one is needed")
        if not (0 < camera.width <= _LARGEST_IMAGE and 0 < camera.height <= _LARGEST_IMAGE):
            raise ValueError(f"image of {camera.width} x {camera.height} pixels; sides from 1 to {_LARGEST_IMAGE}")
        screen = Screen(
            fx=float(camera.fx),
            fy=float(camera.fy),
            cx=float(camera.cx),
            cy=float(camera.cy),
            width=camera.width,
            height=camera.height,
            low_pass_px2=float(low_pass_px2),
            alpha_max=float(alpha_max),
            jacobian_margin=JACOBIAN_MARGIN,
        )
        pieces = features.split(layout.CHANNELS, dim=1)
        if len(pieces) > 1:
            # A pass sees only its own features, but one that is not finite keeps a Gaussian out of all of them.
            drawable = (features.abs() < layout.LARGEST.value).all(dim=1)
            opacities = torch.where(drawable, opacities, 0.0)
        passes = [
            splat(means, scales, rotations, opacities, piece, pose, behind, screen)
            for piece, behind in zip(pieces, background.split(layout.CHANNELS, dim=-1), strict=True)
        ]
        images, alphas, depths = zip(*passes, strict=True)
        return RasterOutput(features=torch.cat(images, dim=-1), alpha=alphas[0], depth=depths[0])
