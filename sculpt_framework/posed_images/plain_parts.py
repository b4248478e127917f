"""Parts of an object that depths do not show, as they are plain or shine: by colours, as far as all views agree.

GrabCut lets each view's outline grow into what looks more like the object than like what is around it. Alone, views
err, each in other places. What the outlines of nearly all views hold in space is part of the object; what some view has
beyond that is not.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from sculpt_framework.posed_images.grab_cut import learned_cut, resized, strip, window_of
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Camera, View

Mask = Bool[np.ndarray, "_ _"]
"""Of any size, each of its own."""
_WIDE, _CORE = 0.18, 0.03
"""How far an outline may grow, and how far inside of it is the object for certain, as shares of the square root of its
area."""
_ROUNDS = 5
_AGREEING = 0.94
"""Share of the views that show a place in which it must be the object."""
_SHOWN = 0.5
"""Share of the views that must show it."""
_LEAST_AROUND = 50
"""Pixels of background that tell how it looks."""


def grown(views: Sequence[View], known: Sequence[Mask]) -> list[Mask]:
    """What each view by itself takes for the object, at the size of what is known of it, which is among it."""
    return in_threads(lambda pair: _grown(*pair), list(zip(views, known, strict=True)))


def agreed(
    points: Float64[np.ndarray, "n 3"], cameras: Sequence[Camera], masks: Sequence[Mask]
) -> Bool[np.ndarray, " n"]:
    """Which of the points nearly all cameras have in their masks that show them; points and cameras in one frame."""
    held, shown = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for own, seen in in_threads(lambda pair: _has(points, *pair), list(zip(cameras, masks, strict=True))):
        held += own
        shown += seen
    return (held >= _AGREEING * shown) & (shown >= max(1.0, _SHOWN * len(cameras)))


def _has(
    points: Float64[np.ndarray, "n 3"], camera: Camera, mask: Mask
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Whether the mask has a point; whether the image shows it."""
    rows, columns = mask.shape
    small = camera.resized(columns, rows)
    pixels = small.project(points)
    shown = small.shows(pixels)
    column, row = np.minimum(pixels[shown], (columns - 1, rows - 1)).astype(np.int64).T
    held = np.zeros(len(points), bool)
    held[shown] = mask[row, column]
    return held, shown


def _grown(view: View, known: Mask) -> Mask:
    size = float(np.sqrt(known.sum()))
    wide = round(_WIDE * size)
    if wide < 1:
        return known
    everywhere = np.ones_like(known)
    trimap = strip(known, wide, sure=everywhere, possible=everywhere, within=max(2, round(_CORE * size)))
    # Only what is near tells how the surroundings look.
    around = (trimap == cv2.GC_BGD)[window_of(trimap != cv2.GC_BGD, wide)]
    if around.sum() < _LEAST_AROUND or not (trimap == cv2.GC_FGD).any():
        return known
    return known | learned_cut(resized(view, known.shape[1], known.shape[0]).image, trimap, _ROUNDS, margin=wide)
