"""An object that is plain all over: of it there are few depths, and those are wrong by some cells where it mirrors.

But what is around it has depths, so that views tell where they see through. What they do not see through is the object
and, around it and in the hole of a handle, the strip in which depth maps have nothing. In that strip colours decide, in
turns with all views' agreement: each view by itself errs, one where a shadow falls, another where it is over-exposed.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float64
from scipy import ndimage

from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps, depth_bounds
from sculpt_framework.multi_view_stereo.fusion import dense_cells
from sculpt_framework.multi_view_stereo.stereo_views import StereoViews
from sculpt_framework.posed_images.grab_cut import disk
from sculpt_framework.posed_images.plain_parts import agreed
from sculpt_framework.posed_images.rough_masks import RoughMask, cut_masks, rough_masks
from sculpt_framework.posed_images.solid import CLEAR, Solid, above, cloud, fills_space
from sculpt_framework.posed_images.support import Plane, find_planes, goes_on
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.types import View

_RING, _TOLD = 3, 0.4
"""Of the pixels so near to its outlines, on the outside, the share that must have a depth. It is 0.56 around a white
jug on a table in a room, and 0.19 around nothing, above a bare table before a void."""
_DOUBTED = (0.06, 0.03)
"""In each turn, how far from the outline colours decide, as shares of the square root of its area."""


def not_seen_through(volume: Volume, maps: DepthMaps, known: str) -> Solid | None:
    """The largest piece above what it stands on that hardly any view sees through; None where nothing ends within the
    volume, or what is around it is not seen. For views from all around; ``known`` as in ``Solid``."""
    points, normals, _ = cloud(maps)
    half = -float(volume.origin[0])
    planes = find_planes(points, normals, half)
    inside = _largest(volume, maps, points, planes)
    # By the cells, as there may be no points on what is plain.
    middles = volume.points.astype(float)
    while parts := [plane for plane in planes if not goes_on(plane, points, middles[inside.reshape(-1)], half)]:
        planes.remove(parts[0])
        inside = _largest(volume, maps, points, planes)
    if fills_space(inside, sure=False) or _told_around(volume, maps, inside) < _TOLD:
        return None
    return Solid(volume=volume, inside=inside, seen=inside, planes=planes, known=known, maps=maps, plain=True)


def _largest(
    volume: Volume, maps: DepthMaps, points: Float64[np.ndarray, "n 3"], planes: Sequence[Plane]
) -> Bool[np.ndarray, "x y z"]:
    on_planes = np.zeros(len(points), bool)
    for plane in planes:
        on_planes |= plane.height(points) < 2 * CLEAR
    reliable = np.zeros(maps.depths.shape, bool)
    reliable[maps.depths > 0] = on_planes
    labels = np.zeros(volume.shape, np.int32)
    ndimage.label(above(planes, volume) & dense_cells(volume, maps, reliable), output=labels)
    sizes = np.bincount(labels.reshape(-1))
    sizes[0] = 0
    return np.asarray(ndimage.binary_fill_holes((labels > 0) & (labels == sizes.argmax())), dtype=bool)


def _told_around(volume: Volume, maps: DepthMaps, inside: Bool[np.ndarray, "x y z"]) -> float:
    """Share of the pixels just outside of its outlines that have a depth."""
    nearest, _ = depth_bounds(maps.views, inside, volume)
    ring, told = 0, 0
    for layer, depths, (rows, columns) in zip(nearest, maps.depths, maps.views.sizes.tolist(), strict=True):
        mask = (layer[:rows, :columns] > 0).astype(np.uint8)
        around = (cv2.dilate(mask, disk(_RING)) > 0) & (mask == 0)
        ring += int(around.sum())
        told += int((depths[:rows, :columns] > 0)[around].sum())
    return told / max(1, ring)


def with_cut_edges(
    given: Sequence[View], posed: Sequence[View], rough: Sequence[RoughMask], stack: StereoViews, solid: Solid
) -> list[RoughMask]:
    """The outlines of what nearly all views take for the object, of that part of the solid.

    ``posed`` are the ``given`` views with cameras in the frame of the solid.
    """
    outlines = list(rough)
    cameras, points = [view.camera for view in posed], solid.volume.points.astype(float)
    for share in _DOUBTED:
        cut = cut_masks(given, [_doubted_at_edge(each, share) for each in outlines], blind=False)
        masks = [view.alpha.numpy() > 0.5 for view in cut if view.alpha is not None]
        inside = solid.inside.copy()
        inside[solid.inside] = agreed(points[solid.inside.reshape(-1)], cameras, masks)
        outlines = rough_masks(stack, len(posed), replace(solid, inside=inside, seen=inside))
    return outlines


def _doubted_at_edge(rough: RoughMask, share: float) -> RoughMask:
    radius = max(1, round(share * float(np.sqrt(rough.inside.sum()))))
    return replace(rough, sure=cv2.erode(rough.inside.astype(np.uint8), disk(radius), borderValue=1) > 0)
