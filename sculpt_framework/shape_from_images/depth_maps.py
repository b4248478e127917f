"""Depth maps of all views by plane sweeping, kept where several views agree."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.shape_from_images.packing import PackedViews
from sculpt_framework.shape_from_images.volume import Volume

with kernel_cache("sweep", Path(__file__).with_name("sweep_kernels.py")):
    from sculpt_framework.shape_from_images.sweep_kernels import count_agreeing, sweep

_ANGLE = 20.0
"""Degrees between two views that are compared at best: more moves the image more per step of depth, but distorts it."""
_ANGLES = (4.0, 45.0)
_WITNESSES = 12
"""Views that are asked whether they have the same depth."""
_TOLERANCE = 1.5
"""Depths are the same within so many steps of the sweep."""
_WORST = 0.06
"""Mean difference of colours above which no depth is believed; colours are in [0, 1]."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    views: int
    """Views that get a depth map, spread evenly."""
    depths: int
    """Depths tried across the object."""
    neighbours: int
    """Views compared with."""
    best_of: int
    """Of these, the best matching ones that count: the others may not see the point."""
    ambiguity: float
    """The nearest depth is taken whose cost is at most so many times the best one's."""
    agreeing: int
    """Views that must have the same depth for it to be kept."""


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
    swept = set(np.linspace(0, len(views) - 1, min(options.views, len(views))).round().astype(int).tolist())
    for i, others in enumerate(views.neighbours(options.neighbours, _ANGLE, _ANGLES)):
        if i not in swept or len(others) < options.best_of:
            continue
        distance = float(np.linalg.norm(views.positions[i]))
        near, far = max(distance - radius, 0.02 * distance), distance + radius
        inverse = np.linspace(1 / near, 1 / far, options.depths).astype(np.float32)
        steps.append(distance**2 * (1 / near - 1 / far) / (options.depths - 1))
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
            options.best_of,
            np.float32(options.ambiguity),
            np.float32(_WORST),
            depths[i],
        )
    step = float(np.median(steps)) if steps else 0.0
    agreeing = np.zeros(depths.shape, np.int32)
    if steps:
        witnesses = np.full((len(views), _WITNESSES), -1, np.int64)
        for i, others in enumerate(views.neighbours(_WITNESSES, 0.0, (0.0, 180.0))):
            witnesses[i, : len(others)] = others
        tolerance = np.float32(_TOLERANCE * step)
        count_agreeing(depths, views.poses, views.lenses, views.positions, witnesses, tolerance, agreeing)
    kept = np.where(agreeing >= options.agreeing, depths, np.float32(np.nan))
    return DepthMaps(depths=kept, step=step, known=float(np.isfinite(kept).sum() / max(1, views.inside.sum())))
