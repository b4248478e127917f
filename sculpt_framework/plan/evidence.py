"""What the plan knows of a scene: numbers measured in seconds on its loaded views."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sculpt_framework.errors import DataError
from sculpt_framework.geometry.angles import angles_between
from sculpt_framework.plan.directions import Gloss, gloss
from sculpt_framework.plan.pictures import (
    WIDTHS,
    blind_views,
    contrast,
    is_cut,
    repeated_views,
    speaking,
    thinnest,
)
from sculpt_framework.spread import spread
from sculpt_framework.types import Box, Scene, View

_LOOKED_AT = 24
"""Views whose pixels are looked at closely, spread evenly."""
_SIDE = 0.9
"""Quantile over these views that speaks for the scene."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Numbers about a scene; lengths are in the object frame, where the box's longest half-side is 1."""

    views: int
    """Train views."""
    masked: int
    """Of these, with an alpha."""
    cut: float = 0.0
    """Share of the masks that the border of their image cuts."""
    blind: tuple[str, ...] = ()
    """Names of views that show nothing of the object."""
    repeated: tuple[tuple[str, str], ...] = ()
    """Pairs of a view and the one it repeats."""
    view_megabytes: float = 0.0
    """Memory of one view's pixels, loaded and cropped for training, at the most."""
    pixel_best: float
    """Width of a pixel at the middle of the object, of the views that show most: only a twentieth has smaller ones."""
    pixel_worst: float
    """The same of those that show least."""
    contrast: tuple[float, ...]
    """Root mean square of brightness finer than 2, 4, 8 and 16 pixels; of the views with most texture."""
    speaking: float
    """Share of the object's pixels where neighbouring views can be compared; of the views where it is largest."""
    apart: float = 0.0
    """Degrees, as seen from the middle of the box, between a view and the one nearest to it; median over the views."""
    thinnest: int | None = None
    """Pixels that the thinnest part is wide at most; None if nothing thin was found."""
    gloss: Gloss | None = None
    """How much colours change with the view; None where that cannot be told."""

    def finer_than(self, pixels: float) -> float:
        """Root mean square of brightness finer than so many pixels."""
        if pixels <= WIDTHS[0]:
            # Half a pixel holds nothing, two hold what was measured.
            return self.contrast[0] * max(0.0, (pixels - 0.5) / (WIDTHS[0] - 0.5))
        return float(np.interp(math.log(pixels), [math.log(width) for width in WIDTHS], self.contrast))


def gather(scene: Scene) -> Evidence:
    """Look at the train views, held-out ones among them: a choice is made for all of them."""
    views, box = scene.train, scene.box
    widths = np.array([_pixel(view, scene) for view in views])
    blind = blind_views(views, box)
    seeing = [view for view in views if view.name not in blind]
    if not seeing:
        raise DataError("no train view shows anything of the object's box; check the box and the cameras.")
    close = spread(seeing, _LOOKED_AT)
    thin = sorted(width for width in map(thinnest, close) if width is not None)
    return Evidence(
        views=len(views),
        masked=sum(view.alpha is not None for view in views),
        cut=float(np.mean([is_cut(view) for view in seeing])),
        blind=blind,
        repeated=repeated_views(seeing, box),
        view_megabytes=float(np.median([view.rgb.shape[0] * view.rgb.shape[1] * 32 / 2**20 for view in views])),
        pixel_best=float(np.quantile(widths, 0.05)),
        pixel_worst=float(np.quantile(widths, 0.95)),
        # Not the median: a side that few views see must not be taken for as plain as the others.
        contrast=tuple(float(value) for value in np.quantile([contrast(view) for view in close], _SIDE, axis=0)),
        speaking=float(np.quantile([speaking(view) for view in close], _SIDE)),
        apart=_apart(seeing, box),
        # One image may be wrong; a part that is thin in two is thin.
        thinnest=thin[1] if len(thin) > 1 else None,
        gloss=gloss(seeing, box),
    )


def _apart(views: Sequence[View], box: Box) -> float:
    """180 where there is but one, or none."""
    if not views:
        return 180.0
    places = [(view.camera.position.double() - box.center.double()).numpy() for view in views]
    angles = angles_between(np.stack(places))
    np.fill_diagonal(angles, 180.0)
    return float(np.median(angles.min(axis=1)))


def _pixel(view: View, scene: Scene) -> float:
    """Width of a pixel at the middle of the box, in object units."""
    pose = view.camera.world_to_camera.double()
    depth = float((pose[:3, :3] @ scene.box.center.double() + pose[:3, 3])[2])
    return max(depth, 1e-6) / scene.box.scale / max(view.camera.fx, view.camera.fy)
