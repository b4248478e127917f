"""Depth maps of all views by plane sweeping, kept where several views agree."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.shape_from_images.packing import PackedViews
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.spread import spread

with kernel_cache("sweep", Path(__file__).with_name("sweep_kernels.py")):
    from sculpt_framework.shape_from_images.sweep_kernels import refine, sweep, witness

_ANGLE = 20.0
"""Degrees between two views that are compared at best: more moves the image more per step of depth, but distorts it."""
_ANGLES = (4.0, 45.0)
_TOLERANCE = 1.5
"""Depths are the same within so many steps of the sweep."""
_WORST = 0.06
"""Mean difference of colours above which no depth is believed; colours are in [0, 1]."""
_NEAREST = 0.02
"""Of the camera's distance from the origin, the least depth."""
_BEST_OF = 3
"""Of the views compared with, the best matching ones that count: the others may not see the point."""
_AMBIGUITY = 1.5
"""The nearest depth is taken whose cost is at most so many times the best one's."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    views: int
    """Views that get a depth map, spread evenly."""
    depths: int
    """Depths tried across the object."""
    neighbours: int
    """Views compared with."""
    agreeing: int
    """Points of other views that must fall on a depth for it to be kept."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthMaps:
    depths: Float32[np.ndarray, "v h w"]
    """Along the camera's axis, in object units; NaN where nothing is known."""
    step: float
    """Distance between neighbouring depths of the sweep at the origin, in object units: the resolution in depth."""
    known: float
    """Share of the masks' pixels that have a depth."""


def find_depths(views: PackedViews, solid: Volume, options: SweepOptions) -> DepthMaps:
    """Sweep each view through the ``solid`` part of the volume (value below 0).

    A view without neighbours at a useful angle has no depths. Without any view, all is empty.
    """
    share_threads()
    depths = np.full(views.inside.shape, np.nan, np.float32)
    radius = solid.radius
    inside: Bool[np.ndarray, "x y z"] = solid.values < 0
    origin = np.array(solid.origin, np.float32)
    steps = []
    swept = set(spread(range(len(views)), options.views))
    for i, others in enumerate(views.neighbours(options.neighbours, _ANGLE, _ANGLES)):
        middle, least = _depth_of_origin(views, i)
        near, far = max(middle - radius, least), middle + radius
        if i not in swept or len(others) < _BEST_OF:
            continue
        inverse = np.linspace(1 / near, 1 / far, options.depths).astype(np.float32)
        steps.append(middle**2 * (1 / near - 1 / far) / (options.depths - 1))
        sweep(
            views.colors,
            views.inside,
            views.poses[i],
            views.positions[i],
            views.lenses,
            i,
            others,
            views.relative(i, others),
            inverse,
            inside,
            origin,
            np.float32(solid.cell),
            _BEST_OF,
            np.float32(_AMBIGUITY),
            np.float32(_WORST),
            depths[i],
        )
    step = float(np.median(steps)) if steps else 0.0
    return _depth_maps(_agreed(views, depths, options.agreeing, tolerance=_TOLERANCE * step), views, step)


def refine_depths(fine: PackedViews, views: PackedViews, maps: DepthMaps, options: SweepOptions) -> DepthMaps:
    """Depth maps of the same views at a higher resolution, found near those of ``maps``, which are of ``views``.

    Where that gives nothing that other views share, as on plain surfaces, depths stay as they were: without them the
    mistakes of a few views would have no one to outvote them.
    """
    share_threads()
    depths = np.full(fine.inside.shape, np.nan, np.float32)
    coarse = depths.copy()
    step = maps.step * float(views.lenses[0, 0] / fine.lenses[0, 0])
    for i, others in enumerate(fine.neighbours(options.neighbours, _ANGLE, _ANGLES)):
        if not np.isfinite(maps.depths[i]).any():
            continue
        refine(
            fine.colors,
            fine.inside,
            fine.lenses,
            i,
            others,
            fine.relative(i, others),
            maps.depths[i],
            views.lenses[i],
            np.float32(step / _depth_of_origin(fine, i)[0] ** 2),
            int(np.ceil(maps.step / step)),
            _BEST_OF,
            np.float32(_WORST),
            depths[i],
            coarse[i],
        )
    exact = _agreed(fine, depths, options.agreeing, tolerance=_TOLERANCE * step)
    return _depth_maps(np.where(np.isfinite(exact), exact, coarse), fine, step)


def _depth_of_origin(views: PackedViews, i: int) -> tuple[float, float]:
    """Along the camera's axis, which need not pass through it; and the least depth that counts, which it never is less
    than."""
    least = _NEAREST * float(np.linalg.norm(views.positions[i]))
    return max(float(views.poses[i, 2, 3]), least), least


def _agreed(
    views: PackedViews, depths: Float32[np.ndarray, "v h w"], least: int, tolerance: float
) -> Float32[np.ndarray, "v h w"]:
    """Without the depths that fewer than ``least`` points of other views share, or that more of them contradict.

    A highlight lies behind the surface that shows it, and so does what a repeated pattern makes believe: some views
    agree on it, but more see the surface in front.
    """
    agreed = np.full_like(depths, np.nan)
    swept = np.flatnonzero(np.isfinite(depths).any(axis=(1, 2)))
    if len(swept) == 0:
        return agreed
    some = depths[swept]
    agreeing, contradicting = np.zeros(some.shape, np.int32), np.zeros(some.shape, np.int32)
    cameras = views.poses[swept], views.lenses[swept], views.positions[swept]
    witness(some, *cameras, np.float32(tolerance), agreeing, contradicting)
    # Points fall between pixels: over 3x3 of them the two numbers can be compared.
    balance = (agreeing - contradicting).astype(np.float32)
    around = np.stack([cv2.blur(plane, (3, 3)) for plane in balance])
    agreed[swept] = np.where((agreeing >= least) & (around >= 0), some, np.float32(np.nan))
    return agreed


def _depth_maps(depths: Float32[np.ndarray, "v h w"], views: PackedViews, step: float) -> DepthMaps:
    return DepthMaps(depths=depths, step=step, known=float(np.isfinite(depths).sum() / max(1, views.inside.sum())))
