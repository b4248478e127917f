"""Parts of an object that depths do not show, as they are plain or shine: by colours, as far as all views agree.

GrabCut lets each view's outline grow into what looks more like the object than like what is around it. Alone, views
err, each in other places. What the outlines of nearly all views hold in space is part of the object; what some view has
beyond that is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from sculpt_framework.threads import in_threads
from sculpt_framework.types import View

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """A view, in the frame of the points that are asked for, and what is known to be the object in it."""

    view: View
    inside: Mask
    """At any size."""


def grown(outlines: Sequence[Outline]) -> list[Mask]:
    """What each view by itself takes for the object, at the size of its outline; what it was given among it."""
    return in_threads(_grown, outlines)


def agreed(
    points: Float32[np.ndarray, "n 3"], outlines: Sequence[Outline], masks: Sequence[Mask]
) -> Bool[np.ndarray, " n"]:
    """Which of the points nearly all views have in their masks that show them."""
    held, shown = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for own, seen in in_threads(lambda pair: _has(points, *pair), list(zip(outlines, masks, strict=True))):
        held += own
        shown += seen
    return (held >= _AGREEING * shown) & (shown >= max(1.0, _SHOWN * len(outlines)))


def _has(
    points: Float32[np.ndarray, "n 3"], outline: Outline, mask: Mask
) -> tuple[UInt8[np.ndarray, " n"], UInt8[np.ndarray, " n"]]:
    """1 where the mask has a point; 1 where the image shows it."""
    rows, columns = mask.shape
    camera = outline.view.camera.resized(columns, rows)
    pose = camera.world_to_camera.float().numpy()
    local = points @ pose[:3, :3].T + pose[:3, 3]
    depth = np.where(local[:, 2] > 0, local[:, 2], np.inf)
    column = np.floor(local[:, 0] / depth * camera.fx + camera.cx).astype(np.int64)
    row = np.floor(local[:, 1] / depth * camera.fy + camera.cy).astype(np.int64)
    shown = (local[:, 2] > 0) & (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
    held = np.zeros(len(points), np.uint8)
    held[shown] = mask[row[shown], column[shown]]
    return held, shown.astype(np.uint8)


def _grown(outline: Outline) -> Mask:
    inside = outline.inside
    size = float(np.sqrt(inside.sum()))
    wide, thin = round(_WIDE * size), max(2, round(_CORE * size))
    if not inside.any() or wide < 1:
        return inside
    outer = _dilated(inside, wide)
    core = cv2.erode(inside.astype(np.uint8), _disk(thin), borderValue=1) > 0
    trimap = np.where(outer, cv2.GC_PR_BGD, cv2.GC_BGD)
    trimap = np.where(inside, cv2.GC_PR_FGD, trimap)
    trimap = np.where(core, cv2.GC_FGD, trimap).astype(np.uint8)
    # Only what is near tells how the surroundings look.
    rows, columns = (np.flatnonzero(_dilated(outer, wide).any(axis=axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    open_at = trimap[window].copy()
    if (open_at == cv2.GC_BGD).sum() < _LEAST_AROUND or not core.any():
        return inside
    size_of_image = (inside.shape[1], inside.shape[0])
    image = cv2.resize(outline.view.rgb.numpy(), size_of_image, interpolation=cv2.INTER_AREA)
    pixels = np.rint(np.asarray(image).clip(0, 1) * 255).astype(np.uint8)[..., ::-1][window]
    background, object_ = np.zeros((1, 65)), np.zeros((1, 65))
    # The clusters it starts from are drawn at random, from a generator of each thread.
    cv2.setRNGSeed(0)
    cv2.grabCut(
        np.ascontiguousarray(pixels), open_at, (0, 0, 1, 1), background, object_, _ROUNDS, cv2.GC_INIT_WITH_MASK
    )
    out = inside.copy()
    out[window] |= (open_at == cv2.GC_FGD) | (open_at == cv2.GC_PR_FGD)
    return out


def _dilated(mask: Mask, wide: int) -> Mask:
    return cv2.dilate(mask.astype(np.uint8), _disk(wide)) > 0


def _disk(radius: int) -> UInt8[np.ndarray, "k k"]:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)).astype(np.uint8)
