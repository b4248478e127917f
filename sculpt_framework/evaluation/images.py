"""How far one image is from another. Images are sRGB in [0, 1], on white, whole."""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

Image = Float[Tensor | np.ndarray, "h w 3"]
Mask = Float[Tensor | np.ndarray, "h w"]


def psnr(image: Image, target: Image) -> float:
    """Peak signal-to-noise ratio in decibels: -10 log10 of the mean squared difference over pixels and channels.

    Values are clipped to [0, 1], as a display does. Equal images give infinity.
    """
    difference = torch.as_tensor(image).double().clamp(0, 1) - torch.as_tensor(target).double().clamp(0, 1)
    mean_squared = float(difference.square().mean())
    return math.inf if mean_squared == 0 else -10 * math.log10(mean_squared)


def ssim(image: Image, target: Image) -> float:
    """Structural similarity in [-1, 1], mean over pixels and channels.

    Gaussian window of 11x11 pixels with sigma 1.5, zero padding, as in 3DGS.
    """
    from sculpt_framework.rendering.photometric import ssim as differentiable_ssim

    first, second = torch.as_tensor(image).float().clamp(0, 1), torch.as_tensor(target).float().clamp(0, 1)
    return float(differentiable_ssim(first, second))


def mask_iou(mask: Mask, target: Mask, threshold: float = 0.5) -> float:
    """Intersection over union, in [0, 1], of the pixels above ``threshold``; 1 where both have none."""
    first, second = torch.as_tensor(mask) > threshold, torch.as_tensor(target) > threshold
    union = int((first | second).sum())
    return int((first & second).sum()) / union if union else 1.0
