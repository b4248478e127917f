"""Views as plain arrays for kernels: cropped to the object, and scaled so that pixels are alike in all of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64

from sculpt_framework.geometry.angles import angles_between
from sculpt_framework.shape_from_images.windows import camera_arrays, covered_window, relative_poses
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Camera, View

_MARGIN = 2
"""Pixels of the input kept around the object."""
_MIXED = 1
"""Pixels along the outline into which what is behind the object mixes."""
_THIN = 3
"""Pixels from the outline to the middle of the widest parts that would lose too much without it."""
_LEAST_SHARE = np.float32(0.02)
"""Of a pixel of a smaller image, from which on there is a colour."""
LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)
_AIM, _NARROW, _WIDE = 12.0, 5.0, 12.0
"""Degrees between two views that are compared at best, and how fast they count less below and above: more moves the
image more per step of depth, but distorts it and hides more."""
_ANGLES = (2.0, 45.0)
"""Degrees outside of which views are not compared."""
_SPREAD = 0.5
"""How much less a view counts that stands in the same direction as one already chosen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoViews:
    """Images of different sizes in the upper left corners of one stack; the rest is black and outside of the masks.

    A point is projected by ``poses`` into camera coordinates (OpenCV), then by ``lenses`` (fx, fy, cx, cy) to pixels.
    """

    luminance: Float32[np.ndarray, "v h w"]
    """In [0, 1]; 0 outside of the masks."""
    inside: Bool[np.ndarray, "v h w"]
    """Pixels that show the object: of its mask, or of the image where there is none."""
    pure: Bool[np.ndarray, "v h w"]
    """Those of them whose luminance is the object's alone: along the outline, what is behind it mixes in."""
    poses: Float32[np.ndarray, "v 3 4"]
    lenses: Float32[np.ndarray, "v 4"]
    positions: Float32[np.ndarray, "v 3"]
    sizes: Int64[np.ndarray, "v 2"]
    """Rows and columns of the images in their corners."""
    given: Int64[np.ndarray, " v"]
    """Which of the views that were given these are: some may have been left out."""

    def __len__(self) -> int:
        return len(self.luminance)

    def relative(self, view: int, others: Int64[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3 4"]:
        """What leads from the camera frame of a view into those of others."""
        return relative_poses(self.poses, view, others)

    def neighbours(self, count: int) -> list[Int64[np.ndarray, " _"]]:
        """For each view the others it is best compared with: ``compared_with`` of their positions."""
        return compared_with(self.positions, count)


def compared_with(positions: Float32[np.ndarray, "v 3"], count: int) -> list[Int64[np.ndarray, " _"]]:
    """For each camera at most ``count`` others that its image is best compared with, the best first; object frame.

    Best is an angle of some 12 degrees, as seen from the origin, and not to stand where another of them does: from
    several sides, one or the other sees what is hidden from the rest.
    """
    chosen = []
    for i, row in enumerate(angles_between(positions)):
        worth = np.exp(-0.5 * ((row - _AIM) / np.where(row < _AIM, _NARROW, _WIDE)) ** 2)
        worth[(row < _ANGLES[0]) | (row > _ANGLES[1])] = 0
        worth[i] = 0
        ways = positions - positions[i]
        ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
        others: list[int] = []
        while len(others) < count and worth.max() > 0:
            best = int(worth.argmax())
            others.append(best)
            worth *= 1 - _SPREAD * np.maximum(ways @ ways[best], 0) ** 2
            worth[best] = 0
        chosen.append(np.array(others, np.int64))
    return chosen


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """One view's share of the stack."""

    camera: Camera
    luminance: Float32[np.ndarray, "h w"]
    inside: Bool[np.ndarray, "h w"]
    pure: Bool[np.ndarray, "h w"]


def stereo_views(views: Sequence[View], pixels_per_unit: float) -> StereoViews:
    """Views, their cameras in the object frame, at about ``pixels_per_unit`` at the origin; never enlarged.

    Views whose mask is empty, or that stand at the origin, are left out.
    """
    prepared = in_threads(lambda view: _prepare(view, pixels_per_unit), views)
    parts = [part for part in prepared if part is not None]
    given = [index for index, part in enumerate(prepared) if part is not None]
    height = max((part.luminance.shape[0] for part in parts), default=0)
    width = max((part.luminance.shape[1] for part in parts), default=0)
    luminance = np.zeros((len(parts), height, width), np.float32)
    inside, pure = np.zeros(luminance.shape, bool), np.zeros(luminance.shape, bool)
    for i, part in enumerate(parts):
        rows, columns = part.luminance.shape
        luminance[i, :rows, :columns] = part.luminance
        inside[i, :rows, :columns] = part.inside
        pure[i, :rows, :columns] = part.pure
    poses, lenses, positions = camera_arrays([part.camera for part in parts])
    return StereoViews(
        luminance=luminance,
        inside=inside,
        pure=pure,
        poses=poses,
        lenses=lenses,
        positions=positions,
        sizes=np.array([part.luminance.shape for part in parts], np.int64).reshape(-1, 2),
        given=np.array(given, np.int64),
    )


def _prepare(view: View, pixels_per_unit: float) -> _Part | None:
    camera, distance = view.camera, float(view.camera.position.norm())
    if distance == 0.0 or (view.alpha is not None and not bool((view.alpha >= 0.5).any())):
        return None
    rgb = view.rgb.cpu().numpy()
    alpha = np.ones(rgb.shape[:2], np.float32) if view.alpha is None else view.alpha.cpu().numpy()
    if view.alpha is not None:
        x, y, width, height = covered_window(view.alpha, _MARGIN)
        camera = camera.crop(x, y, width, height)
        rgb, alpha = rgb[y : y + height, x : x + width], alpha[y : y + height, x : x + width]
    scale = min(1.0, pixels_per_unit * distance / max(camera.fx, camera.fy))
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    whole = away_from_outline(alpha >= 0.5)
    # Multiplied by the coverage, so that what is beside the object is not mixed in, and divided by it again.
    bright = rgb @ LUMINANCE
    layers = np.dstack([bright * alpha, alpha, bright * whole, whole]).astype(np.float32)
    mixed, coverage, luminance, share = np.moveaxis(cv2.resize(layers, size, interpolation=cv2.INTER_AREA), 2, 0)
    pure = share > _LEAST_SHARE
    mixed = np.where(coverage > _LEAST_SHARE, mixed / np.maximum(coverage, _LEAST_SHARE), np.float32(0))
    return _Part(
        camera=camera.resized(*size),
        luminance=np.where(pure, luminance / np.maximum(share, _LEAST_SHARE), mixed),
        inside=coverage >= 0.5,
        pure=pure & (coverage >= 0.5),
    )


def away_from_outline(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The mask without the pixels along its outline, except those of thin parts: of rods and rings little else is left.

    The border of the image is no outline.
    """
    around = np.ones((3, 3), np.uint8)
    whole = mask.astype(np.uint8)
    # One more than it was eroded by: the corners of wide parts are none that are thin.
    wide = cv2.dilate(cv2.erode(whole, around, iterations=_THIN), around, iterations=_THIN + 1)
    return (cv2.erode(whole, around, iterations=_MIXED) > 0) | (mask & (wide == 0))
