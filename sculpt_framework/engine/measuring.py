"""What a run measures of itself: held-out views while it trains, the reference mesh if there is one."""

import math
import resource
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from sculpt_framework.engine.images import TrainingImage
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.images import mask_iou, psnr, ssim
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.triangle_quality import triangle_quality
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Gaussians


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


def mesh_measures(mesh: Mesh, reference: MeasuredMesh | None, samples: int) -> dict[str, float | None]:
    """Curve columns that the mesh alone, or with the reference, gives. Lengths in world units."""
    out: dict[str, float | None] = dict.fromkeys(("chamfer_ps", "fscore", "normal_consistency", "under10_pct"))
    if len(mesh.faces) == 0:
        return out
    out["under10_pct"] = triangle_quality(mesh).under10_pct
    if reference is not None:
        result = chamfer(mesh, reference, samples=samples, point_to_point=False)
        if math.isfinite(result.point_to_surface):
            out["chamfer_ps"] = result.point_to_surface
            out["fscore"] = result.fscore
            out["normal_consistency"] = result.normal_consistency
    return out


def result_measures(mesh: Mesh, reference: Mesh) -> dict[str, Any]:
    """All that is measured of a result: the curve's columns, and each variant of the distance by its own name."""
    out: dict[str, Any] = mesh_measures(mesh, None, 0)
    if len(mesh.faces) > 0:
        distances = chamfer(mesh, reference)
        out |= asdict(distances)
        out |= {"chamfer_ps": distances.point_to_surface, "fscore": distances.fscore}
    return out


def resident_megabytes() -> float:
    """Peak resident memory of this process."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20) if sys.platform == "darwin" else peak / (1 << 10)
