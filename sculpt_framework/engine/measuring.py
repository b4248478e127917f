"""What a run measures of itself: held-out views, and the memory it takes."""

import math
from collections.abc import Sequence

import numpy as np
import torch

from sculpt_framework.engine.gaussian_scene import GaussianScene
from sculpt_framework.engine.images import TrainingImage
from sculpt_framework.engine.reconstruction import object_gaussians
from sculpt_framework.evaluation.images import mask_iou, psnr, ssim
from sculpt_framework.memory import peak_bytes
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Gaussians, Surface


def image_measures(
    rasterizer: Rasterizer, gaussians: Gaussians, images: Sequence[TrainingImage], low_pass_px2: float
) -> dict[str, float | None]:
    """Means over the images of psnr (dB), ssim and iou (of masks), on white; None where there is nothing to tell."""
    scores: dict[str, list[float]] = {"psnr": [], "ssim": [], "iou": []}
    for image in images:
        white = torch.ones(3).to(image.premultiplied)
        with torch.no_grad():
            rendering = rasterizer.render(gaussians, image.camera, white, low_pass_px2=low_pass_px2)
        target = image.over(white)
        scores["psnr"].append(psnr(rendering.rgb, target.rgb))
        scores["ssim"].append(ssim(rendering.rgb, target.rgb))
        if target.alpha is not None:
            scores["iou"].append(mask_iou(rendering.alpha, target.alpha))
    return {name: float(np.mean(values)) if values else None for name, values in scores.items()}


def splat_measures(
    rasterizer: Rasterizer,
    scene: GaussianScene,
    surface: Surface,
    images: Sequence[TrainingImage],
    low_pass_px2: float,
) -> dict[str, float | None]:
    """``image_measures`` of the Gaussians on a surface. Raises FloatingPointError where these are not finite."""
    row = image_measures(rasterizer, object_gaussians(scene, surface), images, low_pass_px2)
    if row["psnr"] is not None and not math.isfinite(row["psnr"]):
        raise FloatingPointError("the rendering of a held-out view is not finite")
    return row


def resident_megabytes() -> float:
    """Peak resident memory of this process."""
    return peak_bytes() / 2**20
