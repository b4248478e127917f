"""The region of interest, from cameras, masks and what else is known: the bounds of the space that no view rules out.

A cube around the point the views look at is carved on a coarse grid, the box of what is left is carved again, and so
on until it stops shrinking.

A mask that its image's border cuts says nothing of what lies beyond. Where a few views show the object whole, they
bound it. Where none do, the hull runs on behind the borders, and something else has to bound it: the box that comes
with the cameras, else the sparse points inside the masks, else what most views show.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.carving import (
    CELLS,
    Corner,
    Outline,
    Rule,
    admits,
    carved_bounds,
    looked_at,
    outline_of,
    shrink,
)
from sculpt_framework.posed_images.clues import NO_CLUES, Clues, points_bounds
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, View

_MARGIN = 0.01  # Added at each side, as a share of the longest side.
_TOLERATED = 0.1  # Share of views that may be wrong (a mask with a hole in it) before the data are refused.
_WHOLE = 3  # Views that show the object whole from which on masks alone bound it.
_SLACK = 0.1  # By which a given box is enlarged before masks are said to reach out of it.
_REACHES_OUT = 0.02  # Share of a mask that may lie outside of it: none is free of specks.
_MAJORITY = 0.5  # Where nothing bounds the object: share of the views that must show a place inside their masks.
_TRIANGULATED = 3  # Masks that a sparse point, or a place in a given box, must lie in: fewer views reconstruct nothing.
_BEYOND = 0.1  # Share of the box by which masks alone must leave more beyond a side, for them not to have decided it.
_FEW = 2  # Views that leave the depth open.
_SIDES = ("-x", "-y", "-z", "+x", "+y", "+z")


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundBox:
    """The scene's box, and how it came about."""

    box: Box
    said: str
    """One line: where the box is, and what decided its sides."""
    cuts: bool
    """Something else than the views' masks or frusta decided a side, so that the object may go on beyond it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Bounds:
    """Bounds, without a margin, of what is left of space."""

    low: Corner
    high: Corner
    allowed: int = 0
    """Views that were outvoted."""
    clipped: bool = False
    """Not closed by the views but by the walls of the space that was looked at."""

    def holds(self, other: "_Bounds") -> bool:
        return bool((self.low <= other.low).all() and (self.high >= other.high).all())


@dataclass(frozen=True, kw_only=True, eq=False)
class _Limit(_Bounds):
    """Bounds that are known otherwise."""

    name: str


def fit_box(views: Sequence[View], clues: Clues = NO_CLUES) -> FoundBox:
    """The bounds of the visual hull with a small margin, and one line that says how they were found.

    Where fewer than three views show the object whole, the clues bound it too, or else the space that half of the views
    show inside their masks. A box among the clues bounds it always, unless most of at least three masks that show the
    object whole reach out of it. Views without alpha say nothing where three others have one; else they count as all
    object, which leaves the intersection of the cameras' frusta.

    Raises DataError if no point in space agrees with the views.
    """
    count = len(views)
    masked = sum(view.alpha is not None for view in views)
    views = views if masked < _WHOLE else [view for view in views if view.alpha is not None]
    outlines = in_threads(outline_of, views)
    whole = sum(outline.closed for outline in outlines) >= min(_WHOLE, len(outlines))
    limit, remark = _limit(outlines, clues, whole)
    found = None if limit is None else _within_limit(outlines, masked, limit, whole)
    if found is None:
        if limit is not None:
            remark = f"; {limit.name} is not used: it holds no place inside the masks"
        shown = 0 if whole else math.ceil(_MAJORITY * len(outlines))
        limit, found = None, bounds_around(outlines, masked, Rule(allowed=0, shown=shown))
    margin = _MARGIN * (found.high - found.low).max()
    box = Box.between(found.low - margin, found.high + margin)
    bounded = _bounded_otherwise(outlines, found, limit, whole)
    source = f"{masked} masks" if masked == len(views) else f"{masked} masks and {len(views)} frusta"
    said = f"{box_in_words(box)} fitted from {source if masked else 'frusta'} of {count} views"
    if bounded.any():
        name = "what half of the views show" if limit is None else limit.name
        said += f"; {_sides(bounded)} by {name}"
        said += "" if bounded.all() else f", {_sides(~bounded)} by {'masks' if masked else 'frusta'}"
    return FoundBox(box=box, said=said + _open_ends(outlines, found) + remark + ".", cuts=bool(bounded.any()))


def box_in_words(box: Box) -> str:
    """Its two corners, to three digits."""
    low, high = (" ".join(f"{value:.3g}" for value in corner.tolist()) for corner in (box.minimum, box.maximum))
    return f"box ({low}) to ({high})"


def _sides(which: Bool[np.ndarray, " 6"]) -> str:
    names = [name for name, chosen in zip(_SIDES, which, strict=True) if chosen]
    return "all sides" if len(names) == len(_SIDES) else " ".join(names)


def _open_ends(outlines: Sequence[Outline], found: _Bounds) -> str:
    text = ""
    if len(outlines) <= _FEW:
        distance = looked_at(outlines)[1]
        text += f"; so few leave the depth open: taken as the object's width around the distance {distance:.3g}"
    elif found.clipped:
        text += "; the views leave it open, it is cut off around the point they look at"
    if found.allowed:
        text += f"; up to {found.allowed} views may contradict the others and are outvoted"
    return text


def _limit(outlines: Sequence[Outline], clues: Clues, whole: bool) -> tuple[_Limit | None, str]:
    """What bounds the object besides its masks, and what there is to say of a clue that does not."""
    if clues.box is not None:
        low, high = clues.box.minimum.double().numpy(), clues.box.maximum.double().numpy()
        # A view without a mask is all object, and reaches out of any box.
        seen_whole = [outline for outline in outlines if outline.closed and outline.distance.any()]
        out = sum(_share_outside(outline, low, high) > _REACHES_OUT for outline in seen_whole)
        if whole and out > 0.5 * len(seen_whole):
            said = f"{out} of {len(seen_whole)} masks of the whole object reach out of it"
            return None, f"; {clues.box_name} is not used: {said}"
        return _Limit(low=low, high=high, name=clues.box_name), ""
    if whole or len(clues.points) == 0:
        return None, ""
    inside = _inside_masks(outlines, clues.points)
    bounds = points_bounds(inside)
    if bounds is None:
        return None, f"; only {len(inside)} of {len(clues.points)} sparse points lie inside the masks and are not used"
    return _Limit(low=bounds[0], high=bounds[1], name=f"{len(inside)} of {len(clues.points)} sparse points"), ""


def _share_outside(outline: Outline, low: Corner, high: Corner) -> float:
    """Share of the mask's pixels from which no ray meets the box, with some slack."""
    slack = _SLACK * (high - low).max()
    rows, columns = np.nonzero(outline.distance == 0)
    ways = (np.stack([columns, rows], axis=1) + 0.5 - outline.center) / outline.focal
    ways = np.column_stack([ways, np.ones(len(ways))]) @ outline.world_to_camera[:3, :3]
    ways = np.where(np.abs(ways) < 1e-12, 1e-12, ways)
    ends = np.stack([(low - slack - outline.position) / ways, (high + slack - outline.position) / ways])
    enters, leaves = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    return float(((enters > leaves) | (leaves < 0)).mean())


def _inside_masks(outlines: Sequence[Outline], points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "m 3"]:
    """Points that lie in several masks, and that almost none of the views that show them rules out."""
    middle = np.median(points, axis=0)
    said = [admits(outline, middle, (points - middle).astype(np.float32), 0.0) for outline in outlines]
    misses = np.sum([~admitted for admitted, _ in said], axis=0)
    shown = np.sum([vote > 0 for _, vote in said], axis=0)
    return points[(misses <= _TOLERATED * (misses + shown)) & (shown >= min(_TRIANGULATED, len(outlines)))]


def _within_limit(outlines: Sequence[Outline], masked: int, limit: _Limit, whole: bool) -> _Bounds | None:
    """The bounds of the hull inside the limit; None if it is empty there."""
    low, high = limit.low, limit.high
    if whole:
        hull = bounds_around(outlines, masked, Rule(allowed=0))
        if limit.holds(hull):
            return hull
        low, high = np.maximum(low, hull.low), np.minimum(high, hull.high)
        if not (low < high).all():
            return None
    for allowed in (0, _outvoted(outlines)):
        bounds = shrink(outlines, low, high, Rule(allowed=allowed, shown=min(_TRIANGULATED, len(outlines))))
        if bounds is not None:
            return _Bounds(low=bounds[0], high=bounds[1], allowed=allowed)
    return None


def bounds_around(outlines: Sequence[Outline], masked: int, rule: Rule) -> _Bounds:
    """The bounds of the hull around the point the views look at, in as much space as it takes up.

    Raises DataError if it is empty.
    """
    center, _ = looked_at(outlines)
    reach = max(o.radius / o.focal.min() * np.linalg.norm(center - o.position) for o in outlines)
    few = len(outlines) <= _FEW
    half = np.full(3, reach * (1.1 if few else 2.0))
    low, high = center - half, center + half
    clipped = False
    for _ in range(4):
        bounds = shrink(outlines, low, high, rule)
        if bounds is None:
            if rule.allowed:
                raise DataError(_disagreement(masked))
            rule = replace(rule, allowed=_outvoted(outlines))
            continue
        cell = (high - low) / CELLS
        clipped = bool(((bounds[0] <= low + cell) | (bounds[1] >= high - cell)).any())
        if few or not clipped:
            break
        low, high = center - 2 * (center - low), center + 2 * (high - center)
    else:
        bounds = shrink(outlines, low, high, rule)
    if bounds is None:
        raise DataError(_disagreement(masked))
    return _Bounds(low=bounds[0], high=bounds[1], allowed=rule.allowed, clipped=clipped)


def _outvoted(outlines: Sequence[Outline]) -> int:
    return max(1, int(_TOLERATED * len(outlines)))


def _disagreement(masked: int) -> str:
    what = "masks" if masked else "frusta"
    return (
        f"no point in space lies inside the {what} of all views: poses and images do not fit together; expected "
        "camera-to-world matrices with OpenGL axes (x right, y up, z backward)."
    )


def _bounded_otherwise(
    outlines: Sequence[Outline], found: _Bounds, limit: _Limit | None, whole: bool
) -> Bool[np.ndarray, " 6"]:
    """The sides, lower ones first, beyond which masks alone would leave more."""
    size = found.high - found.low
    if limit is not None:
        at_wall = np.stack([found.low - limit.low, limit.high - found.high]) <= 1e-3 * size
    elif whole:
        return np.zeros(6, bool)
    else:
        # Much farther than what coarse cells overhang.
        reach = 2 * _BEYOND * size
        cells, rule = np.ones((2 * CELLS,) * 3, bool), Rule(allowed=found.allowed)
        more = carved_bounds(outlines, found.low - reach, found.high + reach, cells, rule)
        assert more is not None  # noqa: S101
        at_wall = np.stack([found.low - more[0], more[1] - found.high]) > _BEYOND * size
    return at_wall.reshape(-1)
