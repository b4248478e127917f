"""What a run measures of itself: held-out views, distance to the reference, and the memory it takes."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.config import MethodConfig
from sculpt_framework.evaluation.consistency import CURVE_PAIRS, CURVE_PIXELS, PosedImages
from sculpt_framework.evaluation.geometry import measured_file
from sculpt_framework.evaluation.images import fitted_psnr, mask_iou, psnr, ssim
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.mesh_report import mesh_measures, result_measures
from sculpt_framework.memory import peak_megabytes
from sculpt_framework.reconstructor import Reconstructor
from sculpt_framework.types import Camera, Rendering, Scene, View

CURVE_SAMPLES, RESULT_SAMPLES = 20_000, 200_000
"""Points on each of two surfaces that a row of the curve, and the result, is measured with."""
_VIEWS_AT_MOST, _PIXELS_AT_MOST = 4, 4_000_000
"""More held-out views, or more pixels in them, add evaluation time, not knowledge."""
_JUDGES = 2
"""Views for what is looked at often."""
_RESULT_PAIRS, _RESULT_PIXELS = 24, 500_000
"""Neighbouring views that a result is judged by, and pixels in each."""
_NO_SIZES: Mapping[str, Any] = {"inner": None, "faces": None, "gaussians": None, "grid": None}
"""Columns of the curve that a method may have nothing for."""


class Evaluator:
    """What a run is held against: views it does not learn from and, where there is one, the reference mesh."""

    def __init__(self, config: MethodConfig, scene: Scene, held_out: Sequence[int]):
        """``held_out`` are numbers of train views; only some of them are looked at."""
        self.views = some_views([scene.train[number] for number in held_out], _VIEWS_AT_MOST, _PIXELS_AT_MOST)
        reference = config.reference or scene.reference_mesh
        self.reference = None if reference is None else measured_file(reference, CURVE_SAMPLES)
        self._scene = scene

    def measure(self, method: Reconstructor) -> dict[str, Any]:
        """A row of the curve. Raises FloatingPointError where a rendering is not finite."""
        row = self._common(method) | mesh_measures(mesh := method.mesh(), self.reference, CURVE_SAMPLES)
        return row if self.reference is not None else {**row, **self._photographs.measure(mesh).values()}

    def measure_start(self, make: Callable[[], tuple[Mesh, Mapping[str, Any]] | None]) -> dict[str, Any] | None:
        """A row of the curve about something to start from, which has no colours yet (``Host.show_start``).

        None without a reference, as nothing is known then, and where there is no surface to measure.
        """
        made = None if self.reference is None else make()
        if made is None:
            return None
        mesh, sizes = made
        blank = dict.fromkeys(("psnr", "psnr_fitted", "ssim", "iou"))
        row = {**_NO_SIZES, **sizes, "rss_mb": peak_megabytes(), **blank}
        return row | mesh_measures(mesh, self.reference, CURVE_SAMPLES)

    def measure_result(self, method: Reconstructor) -> dict[str, Any]:
        """The same of what the run leaves, with all that is measured of a result and as many samples as it deserves."""
        row, mesh = self._common(method), method.mesh()
        if self.reference is not None:
            return row | result_measures(mesh, self.reference.with_samples(RESULT_SAMPLES))
        photographs = PosedImages(
            self._scene.train, self._center, pairs_at_most=_RESULT_PAIRS, pixels_at_most=_RESULT_PIXELS
        )
        return {**row, **result_measures(mesh, None), **photographs.measure(mesh).values()}

    @torch.no_grad()
    def quick_psnr(self, render: Callable[[Camera], Float[Tensor, "h w 3"]]) -> float:
        """Mean on a few of the views, in dB, on white; each costs about as much as an inner step."""
        judges = self.views[:_JUDGES]
        return sum(psnr(render(view.camera), on_white(view)) for view in judges) / len(judges)

    @cached_property
    def _photographs(self) -> PosedImages:
        """What a surface is held against where there is no reference; made when it is first asked for."""
        return PosedImages(self._scene.train, self._center, pairs_at_most=CURVE_PAIRS, pixels_at_most=CURVE_PIXELS)

    @property
    def _center(self) -> np.ndarray:
        return self._scene.box.center.double().cpu().numpy()

    def _common(self, method: Reconstructor) -> dict[str, Any]:
        sizes = {**_NO_SIZES, **method.sizes(), "rss_mb": peak_megabytes()}
        return sizes | image_measures(method.render, self.views)


def some_views(views: Sequence[View], at_most: int, pixels: int) -> Sequence[View]:
    """Spread evenly over the views, as many as have about so many pixels together, but at least three of them."""
    if not views:
        return []
    mean = sum(view.camera.width * view.camera.height for view in views) / len(views)
    count = min(len(views), at_most, max(3, int(pixels / mean)))
    return [views[number * len(views) // count] for number in range(count)]


def on_white(view: View) -> Float[Tensor, "h w 3"]:
    """The view's image in front of a white background."""
    if view.alpha is None:
        return view.rgb.float()
    # Multiplied and blended as training images are, so that both round alike.
    alpha = view.alpha[..., None]
    return (view.rgb * alpha).float() + (1 - alpha.float()) * torch.ones(3)


def image_measures(render: Callable[[Camera], Rendering], views: Sequence[View]) -> dict[str, float | None]:
    """Means over the views that show the object of psnr and psnr_fitted (dB), ssim and iou (of masks), on white.

    None where there is nothing to tell. Raises FloatingPointError where a rendering is not finite.
    """
    scores: dict[str, list[float]] = {"psnr": [], "psnr_fitted": [], "ssim": [], "iou": []}
    for view in views:
        if not view.shows_object:
            continue
        with torch.no_grad():
            rendering = render(view.camera)
        if not bool(torch.isfinite(rendering.rgb).all()):
            raise FloatingPointError("the rendering of a held-out view is not finite")
        target = on_white(view).to(rendering.rgb)
        scores["psnr"].append(psnr(rendering.rgb, target))
        alpha = None if view.alpha is None else view.alpha.to(rendering.alpha)
        scores["psnr_fitted"].append(fitted_psnr(rendering.rgb, target, alpha))
        scores["ssim"].append(ssim(rendering.rgb, target))
        if alpha is not None:
            scores["iou"].append(mask_iou(rendering.alpha, alpha))
    return {name: float(np.mean(values)) if values else None for name, values in scores.items()}
