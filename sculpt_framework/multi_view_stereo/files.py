"""Depth maps of a scene as files: one per view, in world units, and a picture of all of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, UInt8

from sculpt_framework.errors import DataError
from sculpt_framework.export.atomic import make_folder, write_atomically
from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps, StereoOptions, find_depths
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.volume import sample, whole_box
from sculpt_framework.spread import spread
from sculpt_framework.types import Scene, View

Picture = UInt8[np.ndarray, "h w 3"]
_THUMB, _GAP = 150, 6
_ACROSS, _MOST = 3, 60
"""Views in a row of the picture, and in all of it."""
_EXTREMES = (2, 98)
"""Percentiles of a view's depths between which its colours run."""
_PAPER, _INK, _UNKNOWN = 255, (40, 44, 52), 225
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewDepths:
    """What is known of the surface at the pixels of one view, cut to the object and reduced."""

    view: View
    """As the dataset has it."""
    luminance: Float32[np.ndarray, "h w"]
    depth: Float32[np.ndarray, "h w"]
    """Along the camera's axis, in world units; 0 where it is unknown."""
    normal: Float32[np.ndarray, "h w 3"]
    """Unit, in the world frame, facing the camera; 0 where it is unknown."""
    confidence: Float32[np.ndarray, "h w"]
    intrinsics: Float64[np.ndarray, "3 3"]
    """Of these pixels; the middle of the first is at (0.5, 0.5)."""

    @property
    def known(self) -> Bool[np.ndarray, "h w"]:
        return self.depth > 0


def scene_depths(
    scene: Scene, options: StereoOptions, cells: int, tell: Callable[[float], None] = lambda share: None
) -> list[ViewDepths]:
    """Depth maps of the train views that have a mask, within the visual hull of so many ``cells`` along its box.

    Without any mask, of all of them, within the scene's box. ``tell`` hears what share of the work is done. Raises
    DataError where no depth is found in any view.
    """
    masked = [view for view in scene.train if view.alpha is not None]
    chosen = masked or list(scene.train)
    posed = [replace(view, camera=scene.box.camera_to_object(view.camera)) for view in chosen]
    x, y, z = (float(side) for side in scene.box.half_sides)
    cpu = torch.device("cpu")
    solid = sample(visual_hull(posed, len(posed)), (x, y, z), cells, cpu) if masked else whole_box((x, y, z), cells)
    maps = find_depths(posed, solid, options, tell)
    if maps.known == 0.0:
        raise DataError(
            f"{scene.name}: no depth was found in {len(chosen)} views. Each needs others less than 45 degrees away "
            "that show the same texture; check the poses, or take more photographs."
        )
    return [_in_world(maps, i, chosen[maps.views.given[i]], scene.box.scale) for i in range(len(maps.views))]


def _in_world(maps: DepthMaps, index: int, view: View, scale: float) -> ViewDepths:
    rows, columns = maps.views.sizes[index]
    depth = maps.depths[index, :rows, :columns]
    # The object frame is not turned against the world.
    normal = maps.normals[index, :rows, :columns] @ maps.views.poses[index, :, :3]
    fx, fy, cx, cy = maps.views.lenses[index].tolist()
    return ViewDepths(
        view=view,
        luminance=maps.views.luminance[index, :rows, :columns],
        depth=depth * np.float32(scale),
        normal=np.where(depth[..., None] > 0, normal, np.float32(0)),
        confidence=maps.confidence[index, :rows, :columns],
        intrinsics=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64),
    )


def write_depths(found: ViewDepths, folder: Path) -> Path:
    """Write ``NAME.npz`` with depth, normal, confidence, intrinsics and world_to_camera (4x4, OpenCV axes).

    NAME is the view's, folders included. Raises OutputError.
    """
    path = folder / f"{found.view.name}.npz"
    make_folder(path.parent)
    write_atomically(
        path,
        lambda file: np.savez_compressed(
            file,
            depth=found.depth,
            normal=found.normal,
            confidence=found.confidence,
            intrinsics=found.intrinsics,
            world_to_camera=found.view.camera.world_to_camera.double().numpy(),
        ),
    )
    return path


def depth_sheet(found: list[ViewDepths]) -> Picture:
    """Up to 60 views, spread evenly: what was compared, its depth (near red, far blue), its confidence (white is 1)."""
    strips = [_strip(each) for each in spread(found, _MOST)]
    blank = np.full_like(strips[0], _PAPER)
    strips += [blank] * (-len(strips) % _ACROSS)
    return np.vstack([np.hstack(strips[start : start + _ACROSS]) for start in range(0, len(strips), _ACROSS)])


def _strip(found: ViewDepths) -> Picture:
    grey = [np.repeat(np.rint(255 * layer.clip(0, 1)).astype(np.uint8)[..., None], 3, axis=2)
            for layer in (found.luminance, found.confidence)]  # fmt: skip
    out = np.hstack([_thumb(grey[0]), _thumb(_colored(found)), _thumb(grey[1])])
    label = f"{found.view.name[-20:]}  {100 * found.known.mean():.0f} %"
    cv2.putText(out, label, (5, _THUMB - 6), _FONT, 0.35, (255, 255, 255), 3, cv2.LINE_AA)
    cv2.putText(out, label, (5, _THUMB - 6), _FONT, 0.35, _INK, 1, cv2.LINE_AA)
    return out


def _colored(found: ViewDepths) -> Picture:
    known = found.known
    low, high = np.percentile(found.depth[known], _EXTREMES) if known.any() else (0.0, 1.0)
    nearness = ((high - found.depth) / max(high - low, 1e-12)).clip(0, 1)
    # OpenCV's colours are blue, green, red.
    colors = cv2.applyColorMap(np.rint(255 * nearness).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(known[..., None], colors, np.uint8(_UNKNOWN))


def _thumb(pixels: Picture) -> UInt8[np.ndarray, "side side 3"]:
    rows, columns = pixels.shape[:2]
    factor = (_THUMB - _GAP) / max(rows, columns)
    size = max(1, round(columns * factor)), max(1, round(rows * factor))
    # Not mixed: between what is known and what is not there is nothing.
    resized = cv2.resize(np.ascontiguousarray(pixels), size, interpolation=cv2.INTER_NEAREST)
    out = np.full((_THUMB, _THUMB, 3), _PAPER, np.uint8)
    out[_GAP // 2 : _GAP // 2 + size[1], _GAP // 2 : _GAP // 2 + size[0]] = resized
    return out
