"""The object's box from cameras and masks: the bounds of the space that no view rules out.

A cube around the point the views look at is carved on a coarse grid, the box of what is left is carved again, and so
on until it stops shrinking. Cells are tested conservatively, by the distance from their projected centre to the mask
against their projected radius, so that thin parts are never lost, however coarse the grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from sculpt_framework.errors import DataError
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, View

_CELLS = 32  # Along each axis, while the box shrinks.
_FINE_CELLS = 96  # In the last pass; conservative cells overhang by one or two of these, which is part of the margin.
_SHELL = 6  # The last pass looks at this many fine cells below each wall: two of the coarse ones.
_MARGIN = 0.01  # Added at each side, as a share of the longest side.
_MASK_SIDE = 256  # Masks are reduced to about this many pixels: the box needs no more.
_TOLERATED = 0.1  # Share of views that may be wrong (a mask with a hole in it) before the data are refused.

Corner = Float[np.ndarray, " 3"]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Outline:
    """A view reduced to what carving needs, in the pixels of the reduced mask."""

    world_to_camera: Float[np.ndarray, "4 4"]
    focal: Float[np.ndarray, " 2"]
    center: Float[np.ndarray, " 2"]
    distance: Float[np.ndarray, "h w"]
    """Pixels from here to the mask; 0 inside."""
    closed: bool
    """The mask does not touch the image's border, so that nothing of the object is outside the image."""
    middle: Float[np.ndarray, " 2"]
    """Middle of the mask's bounding rectangle."""
    radius: float
    """Half of its longer side."""

    @property
    def position(self) -> Float[np.ndarray, " 3"]:
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def axis(self) -> Float[np.ndarray, " 3"]:
        """Unit direction, in world, through the middle of the mask."""
        ray = np.append((self.middle - self.center) / self.focal, 1.0) @ self.world_to_camera[:3, :3]
        return ray / np.linalg.norm(ray)


def fit_box(views: Sequence[View]) -> tuple[Box, str]:
    """The bounds of the visual hull with a small margin, and one line that says how they were found.

    Views without alpha count as all object, which leaves the intersection of the cameras' frusta.

    Raises DataError if no point in space agrees with the views.
    """
    outlines = in_threads(_outline, views)
    masked = sum(view.alpha is not None for view in views)
    center, distance = _looked_at(outlines)
    reach = max(o.radius / o.focal.min() * np.linalg.norm(center - o.position) for o in outlines)
    few = len(outlines) <= 2
    half = np.full(3, reach * (1.1 if few else 2.0))
    low, high = center - half, center + half
    allowed, clipped = 0, False
    for _ in range(4):
        bounds = _shrink(outlines, low, high, allowed)
        if bounds is None:
            if allowed:
                raise DataError(_disagreement(masked))
            allowed = max(1, int(_TOLERATED * len(outlines)))
            continue
        cell = (high - low) / _CELLS
        clipped = bool(((bounds[0] <= low + cell) | (bounds[1] >= high - cell)).any())
        if few or not clipped:
            break
        low, high = center - 2 * (center - low), center + 2 * (high - center)
    else:
        bounds = _shrink(outlines, low, high, allowed)
    if bounds is None:
        raise DataError(_disagreement(masked))
    low, high = bounds
    margin = _MARGIN * (high - low).max()
    box = Box(minimum=torch.from_numpy(low - margin), maximum=torch.from_numpy(high + margin))
    return box, _sentence(box, masked, len(outlines), distance, clipped, allowed)


def _sentence(box: Box, masked: int, total: int, distance: float, clipped: bool, allowed: int) -> str:
    low, high = (" ".join(f"{value:.3g}" for value in corner.tolist()) for corner in (box.minimum, box.maximum))
    source = f"{masked} masks" if masked == total else f"{masked} masks and {total} frusta" if masked else "frusta"
    text = f"box ({low}) to ({high}) fitted from {source} of {total} views"
    if total <= 2:
        text += f"; so few leave the depth open: taken as the object's width around the distance {distance:.3g}"
    elif clipped:
        text += "; the views leave it open, it is cut off around the point they look at"
    if allowed:
        text += f"; up to {allowed} views may contradict the others and are outvoted"
    return text + "."


def _disagreement(masked: int) -> str:
    what = "masks" if masked else "frusta"
    return (
        f"no point in space lies inside the {what} of all views: poses and images do not fit together; expected "
        "camera-to-world matrices with OpenGL axes (x right, y up, z backward)."
    )


def _outline(view: View) -> _Outline:
    camera = view.camera
    mask = np.ones((camera.height, camera.width), np.uint8)
    if view.alpha is not None:
        mask = (view.alpha.numpy() > 0.5).astype(np.uint8)
    factor = max(1, max(mask.shape) // _MASK_SIDE)
    if factor > 1:
        # The largest value of each block, not the mean: a part thinner than a block must not vanish.
        mask = _largest_of_rows(_largest_of_rows(mask, factor).T, factor).T.copy()
    full = bool(mask.all())
    border = mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any()
    ys, xs = np.nonzero(mask)
    low, high = np.array([xs.min(), ys.min()]), np.array([xs.max() + 1, ys.max() + 1])
    return _Outline(
        world_to_camera=camera.world_to_camera.double().numpy(),
        focal=np.array([camera.fx, camera.fy]) / factor,
        center=np.array([camera.cx, camera.cy]) / factor,
        distance=np.zeros(mask.shape, np.float32) if full else cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5),
        # A view without alpha bounds the object by its frustum: no object is photographed from its inside.
        closed=view.alpha is None or not border,
        middle=(low + high) / 2,
        radius=float((high - low).max() / 2),
    )


def _largest_of_rows(mask: UInt8[np.ndarray, "h w"], factor: int) -> UInt8[np.ndarray, "h2 w"]:
    """Of so many rows at a time, the last ones padded with zeros; along whole rows, which is where numpy is fast."""
    padded = np.pad(mask, ((0, -mask.shape[0] % factor), (0, 0)))
    return np.maximum.reduce([padded[start::factor] for start in range(factor)])


def _looked_at(outlines: Sequence[_Outline]) -> tuple[Float[np.ndarray, " 3"], float]:
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


def _shrink(outlines: Sequence[_Outline], low: Corner, high: Corner, allowed: int) -> tuple[Corner, Corner] | None:
    """Bounds of the hull within a box; None if it is empty."""
    for _ in range(12):
        bounds = _carved_bounds(outlines, low, high, np.ones((_CELLS,) * 3, bool), allowed)
        if bounds is None:
            return None
        shrunk = float(((bounds[1] - bounds[0]) / (high - low)).min())
        low, high = bounds
        if shrunk > 0.9:
            break
    shell = np.ones((_FINE_CELLS,) * 3, bool)
    shell[(slice(_SHELL, -_SHELL),) * 3] = False
    bounds = _carved_bounds(outlines, low, high, shell, allowed)
    # Where a whole slab of the shell is carved, the wall may lie anywhere below it.
    depth = (high - low) * _SHELL / _FINE_CELLS
    if bounds is None:
        return low + depth, high - depth
    return np.minimum(bounds[0], low + depth), np.maximum(bounds[1], high - depth)


def _carved_bounds(
    outlines: Sequence[_Outline], low: Corner, high: Corner, cells: Bool[np.ndarray, "n n n"], allowed: int
) -> tuple[Corner, Corner] | None:
    """Bounds of those cells of a grid over the box that all but ``allowed`` views admit."""
    size = (high - low) / cells.shape[0]
    middle = 0.5 * (low + high)
    # Relative to the middle, so that float32 is enough wherever in the world the object is.
    points = ((np.argwhere(cells) + 0.5 - 0.5 * cells.shape[0]) * size).astype(np.float32)
    radius = 0.5 * float(np.linalg.norm(size))
    # Where no view is closed, space that few views see cannot be carved and is not the object either.
    open_views = not any(outline.closed for outline in outlines)
    misses, seen = np.zeros(len(points), np.int32), np.zeros(len(points), np.int32)
    for outline in outlines:
        admitted, inside = _admits(outline, middle, points, radius)
        misses += ~admitted
        seen += inside
        alive = misses <= allowed
        if not alive.all():
            points, misses, seen = points[alive], misses[alive], seen[alive]
    if open_views:
        points = points[seen >= len(outlines) / 3]
    if len(points) == 0:
        return None
    return middle + points.min(axis=0) - size / 2, middle + points.max(axis=0) + size / 2


def _admits(
    outline: _Outline, middle: Corner, points: Float[np.ndarray, "n 3"], radius: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Whether balls around the points may hold some of the object, and whether their centres are in the image.

    ``points`` are relative to ``middle``.
    """
    rotation, translation = outline.world_to_camera[:3, :3], outline.world_to_camera[:3, 3]
    offset = (rotation @ middle + translation).astype(np.float32)
    x, y, depth = rotation.astype(np.float32) @ points.T + offset[:, None]
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
    inside = (outside == 0) & ~near
    admitted = np.where(near, depth > -radius, gap <= disc * disc)
    if not outline.closed:
        admitted |= (outside > 0) | near
    return admitted, inside
