"""Views that the others outvote: one mask that cuts off a part, or one wrong pose, would cut that part off the object.

What all masks leave of space must explain every one of them. Where a part of one is left unexplained, those views are
left out that cut the most out of what nearly all others agree on, or show what no other does, as few as it takes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.box import bounds_around
from sculpt_framework.posed_images.carving import Corner, Outline, Rule, admits, outline_of
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, View

FEWEST = 6
"""Views from which on one can be wrong and the others know."""
_MOST = 0.2
"""Share of the views that may be wrong; where it would take more, nobody is right."""
_UNEXPLAINED = 0.03
"""Share of a mask that must be unexplained before anyone is suspected: poses are never exact."""
_CELLS = 32
"""Along each axis of the space that is looked at."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Space:
    """Cells that not more than a few views rule out."""

    middle: Float[np.ndarray, " 3"]
    points: Float32[np.ndarray, "n 3"]
    """Centres, relative to ``middle``."""
    radius: float
    ruled_out: Bool[np.ndarray, "v n"]

    def without(self, left_out: Bool[np.ndarray, " v"]) -> Float32[np.ndarray, "m 3"]:
        """What is left of space by the word of the others."""
        return self.points[~self.ruled_out[~left_out].any(axis=0)]


def without_outvoted(views: Sequence[View], box: Box) -> tuple[list[View], list[str]]:
    """The views but for those that contradict the others, and a note that names them.

    ``box``, of the views' frame, is what all of them together leave of space: masks end where it does. Views without
    alpha have nothing to contradict with. Where few views have one, or so many would have to go that nobody can say
    who is right, all stay; the latter is noted.
    """
    numbers = [number for number, view in enumerate(views) if view.alpha is not None and view.shows_object]
    if len(numbers) < FEWEST:
        return list(views), []
    outlines = in_threads(lambda number: outline_of(views[number]), numbers)
    corners = box.minimum.double().numpy(), box.maximum.double().numpy()
    share = _unexplained(outlines, _cells(outlines, *corners, allowed=0), np.zeros(len(outlines), bool)).max()
    if share <= _UNEXPLAINED:
        return list(views), []
    most = max(1, int(_MOST * len(outlines)))
    space = _space(outlines, most)
    wrong = None if space is None else _suspects(outlines, space, most)
    if wrong is None:
        how = f"up to {100 * share:.0f} % of what a mask shows is background in other masks"
        return list(views), [f"{how}: poses or masks are wrong, and which cannot be told."]
    gone = {numbers[index] for index in np.flatnonzero(wrong)}
    if not gone:
        return list(views), []
    told = ", ".join(views[number].name for number in sorted(gone))
    left = [view for number, view in enumerate(views) if number not in gone]
    count = "1 train image is" if len(gone) == 1 else f"{len(gone)} train images are"
    note = (
        f"{count} left out, as the mask or the pose contradicts the others ({told}): together, they leave up to "
        f"{100 * share:.0f} % of what a mask shows unexplained. Look at their masks."
    )
    return left, [note]


def _space(outlines: Sequence[Outline], most: int) -> _Space | None:
    """None where nothing is left of space even if so many are outvoted: that is said where the box is fitted."""
    whole = sum(outline.closed for outline in outlines) > len(outlines) // 2
    try:
        shown = 0 if whole else math.ceil(0.5 * len(outlines))
        bounds = bounds_around(outlines, len(outlines), Rule(allowed=most, shown=shown))
    except DataError:
        return None
    return _cells(outlines, bounds.low, bounds.high, allowed=most)


def _cells(outlines: Sequence[Outline], low: Corner, high: Corner, *, allowed: int) -> _Space:
    middle, size = 0.5 * (low + high), (high - low) / _CELLS
    grid = np.moveaxis(np.indices((_CELLS,) * 3), 0, -1).reshape(-1, 3)
    points = ((grid + 0.5 - 0.5 * _CELLS) * size).astype(np.float32)
    radius = 0.5 * float(np.linalg.norm(size))
    ruled_out = np.stack(in_threads(lambda outline: ~admits(outline, middle, points, radius)[0], outlines))
    kept = ruled_out.sum(axis=0) <= allowed
    return _Space(middle=middle, points=points[kept], radius=radius, ruled_out=ruled_out[:, kept])


def _suspects(outlines: Sequence[Outline], space: _Space, most: int) -> Bool[np.ndarray, " v"] | None:
    """The fewest views without which the others are explained; None where it takes more than ``most``.

    First go those that cut the most out of what nearly all others agree on, so many of them; then those that show what
    no other does.
    """
    best, cutting = None, np.zeros(len(outlines), bool)
    for _ in range(most + 1):
        lone = cutting | (_unexplained(outlines, space, cutting) > _UNEXPLAINED)
        if lone.sum() <= most and not (_unexplained(outlines, space, lone) > _UNEXPLAINED).any():
            best = lone if best is None or lone.sum() <= best.sum() else best
            if not (lone & ~cutting).any():
                break
        # A place that few rule out is evidence against these few.
        ruled = space.ruled_out & ~cutting[:, None]
        blame = (ruled / np.maximum(ruled.sum(axis=0), 1) ** 2).sum(axis=1)
        cutting = cutting.copy()
        cutting[np.argmax(blame)] = True
    if best is None:
        return None
    # Who was suspected before the right one was found is taken back.
    for number in np.flatnonzero(best):
        fewer = best.copy()
        fewer[number] = False
        if not (_unexplained(outlines, space, fewer) > _UNEXPLAINED).any():
            best = fewer
    return best


def _unexplained(
    outlines: Sequence[Outline], space: _Space, left_out: Bool[np.ndarray, " v"]
) -> Float[np.ndarray, " v"]:
    """Share of each mask in which nothing is left of space by the word of those that are not left out; of these, 0."""
    points = space.without(left_out)
    shares = in_threads(lambda outline: _uncovered(outline, space, points), outlines)
    return np.where(left_out, 0.0, shares)


def _uncovered(outline: Outline, space: _Space, points: Float32[np.ndarray, "m 3"]) -> float:
    """Share of a mask that no cell covers."""
    inside = outline.distance == 0
    placed = outline.local(space.middle, points).T
    placed = placed[placed[:, 2] > space.radius]
    if len(placed) == 0:
        return 1.0
    pixels = placed[:, :2] / placed[:, 2:] * outline.focal + outline.center
    height, width = inside.shape
    here = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
    empty = np.ones(inside.shape, np.uint8)
    columns, rows = pixels[here].astype(np.int32).T
    empty[rows, columns] = 0
    reach = outline.focal.max() * space.radius / float(np.median(placed[:, 2])) + 1
    away = cv2.distanceTransform(empty, cv2.DIST_L2, 3) if (empty == 0).any() else np.full(inside.shape, np.inf)
    return float((inside & (away > reach)).sum() / inside.sum())
