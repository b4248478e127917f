"""Carving space by masks: what is left of a box once every view has ruled out what it can.

Cells are tested conservatively, by the distance from their projected centre to the mask against their projected
radius, so that thin parts are never lost, however coarse the grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int8, UInt8

from sculpt_framework.types import View

CELLS = 32
"""Along each axis, while the box shrinks."""
FINE_CELLS = 96
"""In the last pass; conservative cells overhang by one or two of these, which is part of the margin."""
_SHELL = 6  # The last pass looks at this many fine cells below each wall: two of the coarse ones.
_MASK_SIDE = 256  # Masks are reduced to about this many pixels: the box needs no more.

Corner = Float[np.ndarray, " 3"]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """What of space is kept."""

    allowed: int
    """Views that may rule a place out and are outvoted."""
    shown: int = 0
    """Views that have to show a place inside their masks, those that speak against it taken off."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Outline:
    """A view reduced to what carving needs, in the pixels of the reduced mask."""

    world_to_camera: Float[np.ndarray, "4 4"]
    focal: Float[np.ndarray, " 2"]
    center: Float[np.ndarray, " 2"]
    distance: Float[np.ndarray, "h w"]
    """Pixels from here to the mask; 0 inside."""
    touched: Bool[np.ndarray, " 4"]
    """Whether the mask touches the left, right, upper and lower border of the image: the object may go on there."""
    middle: Float[np.ndarray, " 2"]
    """Middle of the mask's bounding rectangle."""
    radius: float
    """Half of its longer side."""

    @property
    def closed(self) -> bool:
        """Nothing of the object is outside the image."""
        return not self.touched.any()

    @property
    def position(self) -> Float[np.ndarray, " 3"]:
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def local(self, middle: Float[np.ndarray, " 3"], points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "3 n"]:
        """Points relative to ``middle``, in the camera's frame."""
        rotation = self.world_to_camera[:3, :3]
        offset = (rotation @ middle + self.world_to_camera[:3, 3]).astype(np.float32)
        return rotation.astype(np.float32) @ points.T + offset[:, None]

    @property
    def axis(self) -> Float[np.ndarray, " 3"]:
        """Unit direction, in world, through the middle of the mask."""
        ray = np.append((self.middle - self.center) / self.focal, 1.0) @ self.world_to_camera[:3, :3]
        return ray / np.linalg.norm(ray)


def outline_of(view: View) -> Outline:
    camera = view.camera
    mask = np.ones((camera.height, camera.width), np.uint8)
    if view.alpha is not None:
        mask = (view.alpha.numpy() > 0.5).astype(np.uint8)
    factor = max(1, max(mask.shape) // _MASK_SIDE)
    if factor > 1:
        # The largest value of each block, not the mean: a part thinner than a block must not vanish.
        mask = _largest_of_rows(_largest_of_rows(mask, factor).T, factor).T.copy()
    full = bool(mask.all())
    touched = np.array([side.any() for side in (mask[:, 0], mask[:, -1], mask[0], mask[-1])])
    ys, xs = np.nonzero(mask)
    low, high = np.array([xs.min(), ys.min()]), np.array([xs.max() + 1, ys.max() + 1])
    return Outline(
        world_to_camera=camera.world_to_camera.double().numpy(),
        focal=np.array([camera.fx, camera.fy]) / factor,
        center=np.array([camera.cx, camera.cy]) / factor,
        distance=np.zeros(mask.shape, np.float32) if full else cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5),
        # A view without alpha bounds the object by its frustum: no object is photographed from its inside.
        touched=touched & (view.alpha is not None),
        middle=(low + high) / 2,
        radius=float((high - low).max() / 2),
    )


def _largest_of_rows(mask: UInt8[np.ndarray, "h w"], factor: int) -> UInt8[np.ndarray, "h2 w"]:
    """Of so many rows at a time, the last ones padded with zeros; along whole rows, which is where numpy is fast."""
    padded = np.pad(mask, ((0, -mask.shape[0] % factor), (0, 0)))
    return np.maximum.reduce([padded[start::factor] for start in range(factor)])


def looked_at(outlines: Sequence[Outline]) -> tuple[Float[np.ndarray, " 3"], float]:
    """The point nearest to the axes through the masks, and the median distance of the cameras from it.

    One view, or parallel ones, leave the depth open; there the point nearest to the world's origin is taken, which is
    where objects are usually put, if it is in front of the cameras.
    """
    projections = [np.eye(3) - np.outer(o.axis, o.axis) for o in outlines]
    normal = np.sum(projections, axis=0)
    target = sum((p @ o.position for p, o in zip(projections, outlines, strict=True)), np.zeros(3))
    # The least of all solutions where there are many: axes within a degree of each other count as parallel.
    point = np.linalg.lstsq(normal, target, rcond=1e-4)[0]
    distances = [float((point - o.position) @ o.axis) for o in outlines]
    if min(distances) <= 0:
        norm = float(np.mean([np.linalg.norm(o.position) for o in outlines])) or 1.0
        point = np.mean([o.position + norm * o.axis for o in outlines], axis=0)
    return point, float(np.median([np.linalg.norm(point - o.position) for o in outlines]))


def shrink(outlines: Sequence[Outline], low: Corner, high: Corner, rule: Rule) -> tuple[Corner, Corner] | None:
    """Bounds of the hull within a box; None if it is empty."""
    for _ in range(12):
        bounds = carved_bounds(outlines, low, high, np.ones((CELLS,) * 3, bool), rule)
        if bounds is None:
            return None
        shrunk = float(((bounds[1] - bounds[0]) / (high - low)).min())
        low, high = bounds
        if shrunk > 0.9:
            break
    shell = np.ones((FINE_CELLS,) * 3, bool)
    shell[(slice(_SHELL, -_SHELL),) * 3] = False
    bounds = carved_bounds(outlines, low, high, shell, rule)
    # Where a whole slab of the shell is carved, the wall may lie anywhere below it.
    depth = (high - low) * _SHELL / FINE_CELLS
    if bounds is None:
        return low + depth, high - depth
    return np.minimum(bounds[0], low + depth), np.maximum(bounds[1], high - depth)


def carved_bounds(
    outlines: Sequence[Outline], low: Corner, high: Corner, cells: Bool[np.ndarray, "n n n"], rule: Rule
) -> tuple[Corner, Corner] | None:
    """Bounds of those cells of a grid over the box that the rule keeps; None if there are none."""
    size = (high - low) / cells.shape[0]
    middle = 0.5 * (low + high)
    # Relative to the middle, so that float32 is enough wherever in the world the object is.
    points = ((np.argwhere(cells) + 0.5 - 0.5 * cells.shape[0]) * size).astype(np.float32)
    radius = 0.5 * float(np.linalg.norm(size))
    misses, votes = np.zeros(len(points), np.int32), np.zeros(len(points), np.int32)
    for outline in outlines:
        admitted, vote = admits(outline, middle, points, radius)
        misses += ~admitted
        votes += vote
        alive = misses <= rule.allowed
        if not alive.all():
            points, misses, votes = points[alive], misses[alive], votes[alive]
    if rule.shown:
        points = points[votes >= rule.shown]
    if len(points) == 0:
        return None
    return middle + points.min(axis=0) - size / 2, middle + points.max(axis=0) + size / 2


def admits(
    outline: Outline, middle: Corner, points: Float[np.ndarray, "n 3"], radius: float
) -> tuple[Bool[np.ndarray, " n"], Int8[np.ndarray, " n"]]:
    """Whether balls around the points may hold some of the object, and what the view says of their centres.

    1: it shows the place inside its mask; -1: the place lies beyond a border of the image that the mask does not touch,
    which speaks against it, though the object may have gone round; 0: neither. ``points`` are relative to ``middle``.
    """
    x, y, depth = outline.local(middle, points)
    near = depth <= 1.01 * radius  # Balls that reach the camera project to no disc.
    inverse = 1 / np.where(near, np.float32(1), depth)
    x, y = x * inverse, y * inverse
    height, width = outline.distance.shape
    column = x * np.float32(outline.focal[0]) + np.float32(outline.center[0])
    row = y * np.float32(outline.focal[1]) + np.float32(outline.center[1])
    nearest_column, nearest_row = np.clip(column, 0, width - 0.01), np.clip(row, 0, height - 0.01)
    outside = (column - nearest_column) ** 2 + (row - nearest_row) ** 2
    # The mask lies in the convex image, so these two legs and the way to the mask make an obtuse triangle.
    gap = outside + outline.distance[nearest_row.astype(np.int32), nearest_column.astype(np.int32)] ** 2
    # A ball projects to an ellipse within this disc; one pixel more for the rounding of the distance map.
    slope = np.sqrt(x * x + y * y)
    disc = outline.focal.max() * radius * (1 + slope) / np.where(near, np.float32(1), depth - radius) + 1.0
    admitted = np.where(near, depth > -radius, gap <= disc * disc)
    shown = (outside == 0) & ~near & admitted
    if outline.closed:
        return admitted, shown.astype(np.int8)
    beyond = np.stack([column < -disc, column > width + disc, row < -disc, row > height + disc])
    against = beyond.any(axis=0) & ~(beyond & outline.touched[:, None]).any(axis=0) & ~near
    return admitted | (outside > 0) | near, shown.astype(np.int8) - against.astype(np.int8)
