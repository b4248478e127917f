"""How far one image is from another. Images are sRGB in [0, 1], on white, whole."""

import math

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

Image = Float[Tensor | np.ndarray, "h w 3"]
Mask = Float[Tensor | np.ndarray, "h w"]
_WINDOW, _SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def psnr(image: Image, target: Image) -> float:
    """Peak signal-to-noise ratio in decibels: -10 log10 of the mean squared difference over pixels and channels.

    Values are clipped to [0, 1], as a display does. Equal images give infinity.
    """
    first, second = _clipped(image), _clipped(target)
    mean_squared = cv2.norm(first, second, cv2.NORM_L2SQR) / first.size
    return math.inf if mean_squared == 0 else -10 * math.log10(mean_squared)


def fitted_psnr(image: Image, target: Image, mask: Mask | None) -> float:
    """``psnr`` after the light of the image is fitted: one gain and offset per channel, by least squares over the mask.

    What a photograph's exposure and white balance change is not counted. The fit is over pixels of the mask above one
    half, all of them without a mask, and changes those alone; a mask without pixels changes nothing.
    """
    fitted, wanted = _clipped(image).copy(), _clipped(target)
    chosen = np.ones(fitted.shape[:2], bool) if mask is None else np.asarray(torch.as_tensor(mask).cpu() > 0.5)
    if chosen.any():
        for channel in range(3):
            values, goal = fitted[chosen, channel].astype(np.float64), wanted[chosen, channel].astype(np.float64)
            variance = values.var()
            gain = ((values - values.mean()) * (goal - goal.mean())).mean() / variance if variance > 0 else 0.0
            fitted[chosen, channel] = goal.mean() + gain * (values - values.mean())
    return psnr(fitted, wanted)


def ssim(image: Image, target: Image) -> float:
    """Structural similarity in [-1, 1], mean over pixels and channels.

    Gaussian window of 11x11 pixels with sigma 1.5, zero padding, as in 3DGS; constants 0.01^2 and 0.03^2. The twin of
    the differentiable one in ``rendering.photometric``, many times as fast on a CPU: the window is separable.
    """
    first, second = _clipped(image), _clipped(target)
    mean_1, mean_2 = _blur(first), _blur(second)
    product, squares = mean_1 * mean_2, mean_1 * mean_1 + mean_2 * mean_2
    covariance, variances = _blur(first * second) - product, _blur(first * first + second * second) - squares
    similar = (2 * product + _C1) * (2 * covariance + _C2)
    apart = (squares + _C1) * (variances + _C2)
    return float(np.mean(similar / apart, dtype=np.float64))


def _clipped(image: Image) -> Float32[np.ndarray, "h w 3"]:
    array = image.detach().cpu().numpy() if isinstance(image, Tensor) else image
    return np.ascontiguousarray(np.clip(array, 0, 1), dtype=np.float32)


def _blur(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    return cv2.GaussianBlur(image, (_WINDOW, _WINDOW), _SIGMA, borderType=cv2.BORDER_CONSTANT).reshape(image.shape)


def mask_iou(mask: Mask, target: Mask, threshold: float = 0.5) -> float:
    """Intersection over union, in [0, 1], of the pixels above ``threshold``; 1 where both have none."""
    first, second = torch.as_tensor(mask) > threshold, torch.as_tensor(target) > threshold
    union = int((first | second).sum())
    return int((first & second).sum()) / union if union else 1.0
