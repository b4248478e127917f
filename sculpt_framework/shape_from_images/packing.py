"""Views as plain arrays for kernels: cropped to the object, and scaled so that pixels are alike in all of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64

from sculpt_framework.geometry.angles import angles_between
from sculpt_framework.shape_from_images.windows import camera_arrays, covered_window, relative_poses
from sculpt_framework.types import View

_MARGIN = 2
"""Pixels of the input kept around the object."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PackedViews:
    """Images of different sizes in the upper left corners of one stack; the rest is black and outside of the masks.

    A point is projected by ``poses`` into camera coordinates (OpenCV), then by ``lenses`` (fx, fy, cx, cy) to pixels.
    """

    colors: Float32[np.ndarray, "v h w 3"]
    """Multiplied by coverage, in [0, 1]."""
    inside: Bool[np.ndarray, "v h w"]
    poses: Float32[np.ndarray, "v 3 4"]
    lenses: Float32[np.ndarray, "v 4"]
    positions: Float32[np.ndarray, "v 3"]

    def __len__(self) -> int:
        return len(self.colors)

    def relative(self, view: int, others: Int64[np.ndarray, " n"]) -> Float32[np.ndarray, "n 3 4"]:
        """What leads from the camera frame of a view into those of others."""
        return relative_poses(self.poses, view, others)

    def neighbours(self, count: int, angle: float, limits: tuple[float, float]) -> list[Int64[np.ndarray, " n"]]:
        """For each view at most ``count`` others, those first whose angle to it is nearest to ``angle``.

        Angles in degrees, between the directions in which the views stand as seen from the origin, within ``limits``.
        Sorted by angle, nearest view first.
        """
        chosen = []
        for i, row in enumerate(angles_between(self.positions)):
            fit = np.flatnonzero((row >= limits[0]) & (row <= limits[1]) & (np.arange(len(row)) != i))
            fit = fit[np.argsort(np.abs(row[fit] - angle), kind="stable")][:count]
            chosen.append(fit[np.argsort(row[fit], kind="stable")])
        return chosen


def pack_views(views: Sequence[View], pixels_per_unit: float) -> PackedViews:
    """Views with masks, their cameras in the object frame, at about ``pixels_per_unit`` at the origin; never enlarged.

    Views whose mask is empty, or that stand at the origin, are left out.
    """
    packed = [part for view in views if (part := _prepare(view, pixels_per_unit)) is not None]
    height = max((view.rgb.shape[0] for view in packed), default=0)
    width = max((view.rgb.shape[1] for view in packed), default=0)
    colors = np.zeros((len(packed), height, width, 3), np.float32)
    inside = np.zeros((len(packed), height, width), bool)
    for i, view in enumerate(packed):
        rows, columns = view.rgb.shape[:2]
        colors[i, :rows, :columns] = view.rgb.numpy()
        inside[i, :rows, :columns] = view.alpha.numpy() >= 0.5 if view.alpha is not None else True
    poses, lenses, positions = camera_arrays([view.camera for view in packed])
    return PackedViews(
        colors=colors,
        inside=inside,
        poses=poses,
        lenses=lenses,
        positions=positions,
    )


def _prepare(view: View, pixels_per_unit: float) -> View | None:
    distance = float(view.camera.position.norm())
    if view.alpha is None or distance == 0.0:
        return None
    if not bool((view.alpha >= 0.5).any()):
        return None
    x, y, width, height = covered_window(view.alpha, _MARGIN)
    camera = view.camera.crop(x, y, width, height)
    alpha = view.alpha[y : y + height, x : x + width].cpu().numpy()
    rgb = view.rgb[y : y + height, x : x + width].cpu().numpy() * alpha[..., None]
    scale = min(1.0, pixels_per_unit * distance / max(camera.fx, camera.fy))
    size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    shrunk = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (rgb, alpha)]
    return replace(
        view, camera=camera.resized(*size), rgb=torch.from_numpy(shrunk[0]), alpha=torch.from_numpy(shrunk[1])
    )
