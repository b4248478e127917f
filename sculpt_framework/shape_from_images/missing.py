"""What masks show and a shape does not cover: thin and plain parts, of which depths tell nothing."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.threads import in_threads

with kernel_cache("rays", Path(__file__).with_name("ray_kernels.py")):
    from sculpt_framework.shape_from_images import ray_kernels

ASKING = 3
"""Views in whose masks a place must be missing for it to be filled."""
_LEADING = np.float32(0.8)
"""Share of the largest surplus of views on a ray of an open part, of those that ask over those that see through, with
which a place may be what is missing there."""
_RIM, _WIDTH = 1.5, 3.0
"""Pixels around what is covered by which a mask may be wider without anything missing there; and around what is surely
missing, within which the rest of it lies."""


@runtime_checkable
class Masked(Protocol):
    """Masks in the upper left corners of one stack, and their cameras. A point is projected by ``poses`` into camera
    coordinates (OpenCV), then by ``lenses`` (fx, fy, cx, cy) to pixels."""

    @property
    def inside(self) -> Bool[np.ndarray, "v h w"]: ...
    @property
    def poses(self) -> Float32[np.ndarray, "v 3 4"]: ...
    @property
    def lenses(self) -> Float32[np.ndarray, "v 4"]: ...
    @property
    def positions(self) -> Float32[np.ndarray, "v 3"]: ...


def missing(
    full: Bool[np.ndarray, "x y z"],
    solid: Volume,
    views: Masked,
    depths: Float32[np.ndarray, "v h w"],
    back: float,
    doubtful: Bool[np.ndarray, "x y z"] | None = None,
) -> Bool[np.ndarray, "x y z"]:
    """Cells within ``solid`` that would cover what masks show and ``full`` leaves open: a hull of what is missing.

    Each ray of a mask meets the object. A place that lies in the open parts of three masks or more, and that no more
    views see through, is what they show. A view sees through it if its depth lies more than ``back`` behind, in object
    units; depths that are 0 or not a number are not known.

    Views that see the rim of an opening from the side would close it with a lid so. Where it is known which cells are
    ``doubtful``, for which what speaks counts half, a ray takes no more than the best of its cells: one is enough to
    explain it.
    """
    origin, cell = np.array(solid.origin, np.float32), np.float32(solid.cell)

    def open_part(view: int) -> Bool[np.ndarray, "h w"]:
        inside = views.inside[view]
        covered = np.zeros(inside.shape, bool)
        ray_kernels.mark_met(
            inside, views.poses[view], views.lenses[view], views.positions[view], full, origin, cell, covered
        )
        return _open_part(inside, covered)

    open_parts = np.array(in_threads(open_part, range(len(views.inside))), bool).reshape(views.inside.shape)
    asked = np.flatnonzero((solid.values < 0) & ~full)
    points, surplus = solid.points[asked], np.zeros(len(asked), np.int32)
    share_threads()
    ray_kernels.count_missing(points, open_parts, depths, views.poses, views.lenses, np.float32(back), ASKING, surplus)
    asked, points, surplus = asked[surplus > 0], points[surplus > 0], surplus[surplus > 0]
    if doubtful is not None:
        # Rounded up, so that a doubtful cell is still better than none.
        surplus -= np.where(doubtful.reshape(-1)[asked], surplus // 2, 0).astype(np.int32)
        asked = asked[_leading(points, surplus, open_parts, views, cell)]
    found = np.zeros(full.size, bool)
    found[asked] = True
    return found.reshape(full.shape)


def _leading(
    points: Float32[np.ndarray, "n 3"],
    surplus: Int32[np.ndarray, " n"],
    open_parts: Bool[np.ndarray, "v h w"],
    views: Masked,
    cell: np.float32,
) -> Bool[np.ndarray, " n"]:
    """Which points have four fifths of the largest surplus on rays of open parts, in three views or more."""

    def most_on_rays(view: int) -> Int32[np.ndarray, "h w"]:
        most = np.zeros(open_parts.shape[1:], np.int32)
        ray_kernels.most_on_rays(points, surplus, open_parts[view], views.poses[view], views.lenses[view], most)
        return _largest_around(most, float(cell * views.lenses[view, 0] / np.linalg.norm(views.positions[view])))

    most = np.array(in_threads(most_on_rays, range(len(open_parts))), np.int32).reshape(open_parts.shape)
    chosen = np.zeros(len(points), bool)
    share_threads()
    ray_kernels.choose_missing(points, surplus, open_parts, most, views.poses, views.lenses, _LEADING, ASKING, chosen)
    return chosen


def _largest_around(values: Int32[np.ndarray, "h w"], cell: float) -> Int32[np.ndarray, "h w"]:
    """Within the pixels that a cell of such a width, seen in the middle, may cover: it is known by its centre only."""
    side = 2 * max(1, round(cell / 2)) + 1
    return cv2.dilate(values.astype(np.float32), np.ones((side, side), np.uint8)).astype(np.int32)


def _open_part(inside: Bool[np.ndarray, "h w"], covered: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """What of a mask is not covered, but for a rim around what is."""
    left = inside & ~covered
    if not (left.any() and covered.any()):
        return left
    beyond = left & (_distances(covered) > _RIM)
    return left & (_distances(beyond) <= _WIDTH) if beyond.any() else beyond


def _distances(pixels: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """From each pixel to the nearest of those given, of which there is one."""
    return np.asarray(cv2.distanceTransform((~pixels).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
