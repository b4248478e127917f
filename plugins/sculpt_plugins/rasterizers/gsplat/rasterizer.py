"""gsplat's rasterisation behind the framework's contract."""

import importlib
import logging
from collections.abc import Callable

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.errors import ComponentImportError, DeviceError, first_line
from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.types import Camera

_ALPHA_MAX = 0.999
"""gsplat's own ceiling, which cannot be set."""


class GsplatRasterizer(Rasterizer):
    """float32 on a CUDA device; written for gsplat 1.5.3.

    Where it differs from the other backends:

    - a pixel stops before the splat that would bring its transmittance to ``TRANSMITTANCE_MIN``, not after it;
    - determinants of screen covariances are differences, so that slivers lose digits;
    - gradients are added up atomically and differ in their last bits from run to run;
    - ties in depth are not broken by index.
    """

    def __init__(self, rasterization: Callable):
        self._rasterization = rasterization

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
        """Raises TypeError for tensors that are not float32, ValueError for limits and another ``alpha_max``."""
        if alpha_max != _ALPHA_MAX:
            raise ValueError(f"alpha_max is {alpha_max}; rasterizer 'gsplat' knows no other than {_ALPHA_MAX}")
        if low_pass_px2 < 0.0:
            raise ValueError(f"low_pass_px2 is {low_pass_px2}; a variance is not negative")
        if features.shape[1] == 0:
            raise ValueError("features have no channels; at least one is needed")
        named = {"means": means, "scales": scales, "rotations": rotations, "opacities": opacities, "features": features}
        for name, tensor in named.items():
            if tensor.dtype != torch.float32:
                raise TypeError(
                    f"rasterizer 'gsplat' takes float32, but {name} is {tensor.dtype}: convert it, or use rasterizer "
                    "'reference'"
                )
        splatted, alpha = self._splatted(means, scales, rotations, opacities, features, camera, low_pass_px2)
        behind = (1.0 - alpha)[..., None] * background.detach()
        return RasterOutput(features=splatted[..., :-1] + behind, alpha=alpha, depth=splatted[..., -1])

    def _splatted(
        self,
        means: Float[Tensor, "g 3"],
        scales: Float[Tensor, "g 3"],
        rotations: Float[Tensor, "g 3 3"],
        opacities: Float[Tensor, " g"],
        features: Float[Tensor, "g c"],
        camera: Camera,
        low_pass_px2: float,
    ) -> tuple[Float[Tensor, "h w c+1"], Float[Tensor, "h w"]]:
        """Weighted features and depth, and alpha, over nothing."""
        drawn = _drawable(means, scales, rotations, opacities, features)
        # Left out before anything is computed: a NaN that is masked away afterwards comes back in the gradient.
        chosen = [value[drawn] for value in (means, scales, rotations, opacities, features)]
        means, scales, rotations, opacities, features = chosen
        if means.shape[0] == 0:
            # Connected to the inputs, so that they get gradients of zero.
            nothing = torch.stack([value.sum() for value in chosen]).sum() + 0.0 * camera.world_to_camera.sum()
            sides = camera.height, camera.width
            return nothing.expand(*sides, features.shape[1] + 1), nothing.expand(*sides)
        # Covariances, as the columns of ``rotations`` need not be orthogonal: no quaternion stands for them.
        axes = rotations * scales[:, None, :]
        lens = means.new_tensor([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        images, alphas, _ = self._rasterization(
            means=means,
            quats=None,
            scales=None,
            covars=axes @ axes.mT,
            opacities=opacities,
            colors=features,
            viewmats=camera.world_to_camera[None],
            Ks=lens[None],
            width=camera.width,
            height=camera.height,
            near_plane=self.NEAR,
            eps2d=low_pass_px2,
            packed=False,
            render_mode="RGB+D",
            rasterize_mode="classic",
        )
        return images[0], alphas[0, ..., 0]


@torch.no_grad()
def _drawable(
    means: Float[Tensor, "g 3"],
    scales: Float[Tensor, "g 3"],
    rotations: Float[Tensor, "g 3 3"],
    opacities: Float[Tensor, " g"],
    features: Float[Tensor, "g c"],
) -> Int64[Tensor, " drawable"]:
    """Indices of the Gaussians of which all numbers are finite: gsplat would smear the others over the image."""
    variances = (rotations * scales[:, None, :]).square().flatten(start_dim=1)
    values = torch.cat([means, variances, opacities[:, None], features], dim=1)
    return torch.isfinite(values).all(dim=1).nonzero()[:, 0]


def load_gsplat(device: torch.device) -> Callable:
    """The function ``gsplat.rasterization``, after it has drawn one Gaussian.

    Its kernels are compiled when they are first used, and without a CUDA compiler they are missing: found out here,
    before there is anything to lose. Raises ComponentImportError and DeviceError.
    """
    try:
        rasterization = importlib.import_module("gsplat").rasterization
    except Exception as error:  # Whatever a broken installation raises.
        raise ComponentImportError(
            f"rasterizer 'gsplat' needs the package gsplat, which cannot be imported ({first_line(error)}). Install "
            "it with pip install 'gaussian-sculpting[gsplat]', or use --rasterizer triton."
        ) from error
    logging.getLogger("sculpt").info("rasterizer gsplat: compiling its CUDA kernels, minutes when it is the first time")
    try:
        GsplatRasterizer(rasterization).draw_one(device)
    except Exception as error:  # A missing compiler shows as anything from AttributeError to CalledProcessError.
        raise DeviceError(
            f"rasterizer 'gsplat' does not run on {device} ({first_line(error)}). It needs a CUDA toolkit with nvcc "
            "that fits torch, and a C++ compiler; --rasterizer triton needs a C compiler alone."
        ) from error
    return rasterization
