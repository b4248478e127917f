"""What a run measures of itself: held-out views, distance to the reference, and the memory it takes."""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.images import prepare_image
from sculpt_framework.evaluation.consistency import CURVE_PAIRS, CURVE_PIXELS, PosedImages
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.images import fitted_psnr, mask_iou, psnr, ssim
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.evaluation.mesh_report import mesh_measures, result_measures
from sculpt_framework.extractors import Extractor
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.losses import TrainingImage
from sculpt_framework.memory import peak_bytes
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.sculpting.gaussian_scene import GaussianScene
from sculpt_framework.sculpting.initial_fit import start_surface
from sculpt_framework.sculpting.reconstruction import object_gaussians, world_mesh
from sculpt_framework.types import Gaussians, Scene, Surface, View

_CURVE_SAMPLES, _RESULT_SAMPLES = 20_000, 200_000
_VIEWS_AT_MOST, _PIXELS_AT_MOST = 4, 4_000_000
"""More held-out views, or more pixels in them, add evaluation time, not knowledge."""
_JUDGES = 2
"""Views for what is looked at often."""
_RESULT_PAIRS, _RESULT_PIXELS = 24, 500_000
"""Neighbouring views that a result is judged by, and pixels in each."""


class Yardstick:
    """What a run is held against: views it does not learn from and, where there is one, the reference mesh."""

    def __init__(
        self, config: MethodConfig, scene: Scene, held_out: Sequence[int], rasterizer: Rasterizer, device: torch.device
    ):
        """``held_out`` are numbers of train views; only some of them are looked at."""
        views = some_views([scene.train[number] for number in held_out], _VIEWS_AT_MOST, _PIXELS_AT_MOST)
        reference = config.reference or scene.reference_mesh
        self.images = [prepare_image(view, scene.box, 1.0, device, crop=False) for view in views]
        self.reference = None if reference is None else MeasuredMesh(load_mesh(reference), _CURVE_SAMPLES)
        self._rasterizer = rasterizer
        self._box, self._views = scene.box, scene.train
        self._low_pass_px2 = config.trainer.low_pass_px2

    def measure(self, scene: GaussianScene, surface: Surface) -> dict[str, Any]:
        """A row of the curve: the surface (object frame) that the scene's rows are on.

        Raises FloatingPointError where its rendering is not finite.
        """
        mesh = self._mesh(surface)
        row = self._splats(scene, surface) | mesh_measures(mesh, self.reference, _CURVE_SAMPLES)
        return row if self.reference is not None else {**row, **self._photographs.measure(mesh).values()}

    def measure_start(self, target: SdfFunction, extractor: Extractor, device: torch.device) -> dict[str, Any] | None:
        """A row of the curve about something to start from, which has no Gaussians yet.

        None without a reference, as nothing is known then, and where there is no surface to measure.
        """
        if self.reference is None:
            return None
        try:
            surface = start_surface(target, extractor, device)
        except EmptySurfaceError:
            return None
        row: dict[str, Any] = {"inner": 0, "faces": surface.faces.shape[0], "gaussians": 0}
        row |= {
            "grid": max(extractor.grid.shape),
            "rss_mb": resident_megabytes(),
            "psnr": None,
            "psnr_fitted": None,
            "ssim": None,
            "iou": None,
        }
        return row | mesh_measures(self._mesh(surface), self.reference, _CURVE_SAMPLES)

    def measure_result(self, scene: GaussianScene, surface: Surface) -> dict[str, Any]:
        """The same of what the run leaves, with all that is measured of a result and as many samples as it deserves."""
        mesh, splats = self._mesh(surface), self._splats(scene, surface)
        if self.reference is not None:
            return splats | result_measures(mesh, self.reference.with_samples(_RESULT_SAMPLES))
        photographs = PosedImages(self._views, self._center, pairs_at_most=_RESULT_PAIRS, pixels_at_most=_RESULT_PIXELS)
        return {**splats, **result_measures(mesh, None), **photographs.measure(mesh).values()}

    @torch.no_grad()
    def quick_psnr(self, gaussians: Gaussians) -> float:
        """Mean on a few of the views, in dB, on white; each costs about as much as an inner step."""
        total, judges = 0.0, self.images[:_JUDGES]
        for image in judges:
            white = torch.ones(3).to(image.premultiplied)
            rendering = self._rasterizer.render(
                gaussians, image.camera, white, low_pass_px2=self._low_pass_px2, normals=False
            )
            total += psnr(rendering.rgb, image.over(white).rgb)
        return total / len(judges)

    @cached_property
    def _photographs(self) -> PosedImages:
        """What a surface is held against where there is no reference; made when it is first asked for."""
        return PosedImages(self._views, self._center, pairs_at_most=CURVE_PAIRS, pixels_at_most=CURVE_PIXELS)

    @property
    def _center(self) -> np.ndarray:
        return self._box.center.double().cpu().numpy()

    def _mesh(self, surface: Surface) -> Mesh:
        return world_mesh(surface, self._box)[0]

    def _splats(self, scene: GaussianScene, surface: Surface) -> dict[str, float | None]:
        row = image_measures(self._rasterizer, object_gaussians(scene, surface), self.images, self._low_pass_px2)
        if row["psnr"] is not None and not math.isfinite(row["psnr"]):
            raise FloatingPointError("the rendering of a held-out view is not finite")
        return row


def some_views(views: Sequence[View], at_most: int, pixels: int) -> Sequence[View]:
    """Spread evenly over the views, as many as have about so many pixels together, but at least three of them."""
    if not views:
        return []
    mean = sum(view.camera.width * view.camera.height for view in views) / len(views)
    count = min(len(views), at_most, max(3, int(pixels / mean)))
    return [views[number * len(views) // count] for number in range(count)]


def image_measures(
    rasterizer: Rasterizer, gaussians: Gaussians, images: Sequence[TrainingImage], low_pass_px2: float
) -> dict[str, float | None]:
    """Means over the images of psnr and psnr_fitted (dB), ssim and iou (of masks), on white.

    None where there is nothing to tell.
    """
    scores: dict[str, list[float]] = {"psnr": [], "psnr_fitted": [], "ssim": [], "iou": []}
    for image in images:
        white = torch.ones(3).to(image.premultiplied)
        with torch.no_grad():
            rendering = rasterizer.render(gaussians, image.camera, white, low_pass_px2=low_pass_px2)
        target = image.over(white)
        scores["psnr"].append(psnr(rendering.rgb, target.rgb))
        scores["psnr_fitted"].append(fitted_psnr(rendering.rgb, target.rgb, target.alpha))
        scores["ssim"].append(ssim(rendering.rgb, target.rgb))
        if target.alpha is not None:
            scores["iou"].append(mask_iou(rendering.alpha, target.alpha))
    return {name: float(np.mean(values)) if values else None for name, values in scores.items()}


def resident_megabytes() -> float:
    """Peak resident memory of this process."""
    return peak_bytes() / 2**20
