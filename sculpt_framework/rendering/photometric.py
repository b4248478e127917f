"""The colour loss of 3DGS: L1 and D-SSIM."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from sculpt_framework.cpu_kernels import float32_on_cpu, kernel_cache, share_threads

with kernel_cache("photometric", Path(__file__).with_name("photometric_kernels.py")):
    from sculpt_framework.rendering import photometric_kernels

WINDOW = 11
"""Pixels across the Gaussian window."""
SIGMA = 1.5
"""Standard deviation of the window in pixels."""
C1, C2 = 0.01**2, 0.03**2
"""Stabilisers of SSIM for images in [0, 1]."""


def l1_dssim(image: Float[Tensor, "h w c"], target: Float[Tensor, "h w c"], weight_dssim: float) -> Float[Tensor, ""]:
    """(1 - weight) mean |image - target| + weight (1 - SSIM), means over pixels and channels.

    SSIM with an 11x11 Gaussian window of sigma 1.5 and zeros around the image, as in 3DGS. float32 on the CPU runs in
    compiled kernels that give the value and its gradient by ``image`` in one go; anything else runs in torch.
    """
    if float32_on_cpu(image, target) and not target.requires_grad:
        differentiate = image.requires_grad and torch.is_grad_enabled()
        return _CompiledLoss.apply(image, target, weight_dssim, differentiate)
    return l1_dssim_in_torch(image, target, weight_dssim)


def l1_dssim_in_torch(
    image: Float[Tensor, "h w c"], target: Float[Tensor, "h w c"], weight_dssim: float
) -> Float[Tensor, ""]:
    """``l1_dssim`` in plain torch: any device and floating-point type, differentiable in both images."""
    l1 = (image - target).abs().mean()
    return (1.0 - weight_dssim) * l1 + weight_dssim * (1.0 - ssim(image, target))


def ssim(image: Float[Tensor, "h w c"], target: Float[Tensor, "h w c"]) -> Float[Tensor, ""]:
    """Structural similarity (Wang et al. 2004) in [-1, 1], mean over pixels and channels; images in [0, 1]."""
    x, y = image.movedim(-1, 0), target.movedim(-1, 0)
    mean_x, mean_y, squares, product = _blur(torch.stack([x, y, x * x + y * y, x * y]))
    means_squared = mean_x * mean_x + mean_y * mean_y
    means_product = mean_x * mean_y
    luminance = (2.0 * means_product + C1) / (means_squared + C1)
    structure = (2.0 * (product - means_product) + C2) / (squares - means_squared + C2)
    return (luminance * structure).mean()


def _blur(stack: Float[Tensor, "s c h w"]) -> Float[Tensor, "s c h w"]:
    """The Gaussian window over each image, one axis after the other, zeros outside."""
    window = _window(stack.dtype, stack.device)
    planes = stack.reshape(-1, 1, *stack.shape[2:])
    planes = functional.conv2d(planes, window[None, None, None, :], padding=(0, WINDOW // 2))
    planes = functional.conv2d(planes, window[None, None, :, None], padding=(WINDOW // 2, 0))
    return planes.reshape(stack.shape)


def _window(dtype: torch.dtype, device: torch.device) -> Float[Tensor, " taps"]:
    offset = torch.arange(WINDOW, dtype=dtype, device=device) - WINDOW // 2
    window = torch.exp(-offset * offset / (2.0 * SIGMA * SIGMA))
    return window / window.sum()


class _CompiledLoss(torch.autograd.Function):
    """The gradient is formed together with the value: it needs the same windows."""

    @staticmethod
    def forward(ctx, image: Tensor, target: Tensor, weight_dssim: float, differentiate: bool) -> Tensor:
        height, width, channels = image.shape
        gradient = torch.empty(image.shape if differentiate else (0, width, channels))
        similarity, difference = np.empty(height, np.float32), np.empty(height, np.float32)
        count = max(image.numel(), 1)
        photometric_kernels.compare(
            image.detach().contiguous().reshape(height, width * channels).numpy(),
            target.contiguous().reshape(height, width * channels).numpy(),
            channels,
            min(share_threads(), height),
            np.float32((1.0 - weight_dssim) / count),
            np.float32(-weight_dssim / count),
            similarity,
            difference,
            gradient.reshape(gradient.shape[0], width * channels).numpy(),
        )
        ctx.save_for_backward(gradient)
        l1, ssim_mean = difference.sum(dtype=np.float64) / count, similarity.sum(dtype=np.float64) / count
        return image.new_tensor((1.0 - weight_dssim) * l1 + weight_dssim * (1.0 - ssim_mean))

    @staticmethod
    @once_differentiable
    def backward(ctx, to_value: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = ctx.saved_tensors
        return gradient * to_value, None, None, None
