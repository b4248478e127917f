"""Masks from the photographs themselves: what neighbouring views show at the same depth is a shape, and its outlines.

Coarse depth maps of everything around the object are joined into a volume. The plane that the object stands on is cut
away, and of the pieces that are left those that most of the depths lie on are the object. Its outlines are right in
all views together, to a pixel of the coarse images. Parts without depths are added where the colours of all views agree
(``plain_parts``); along the outlines, each view's colours decide. An object that has hardly any depths is what hardly
any view sees through (``plain_object``).
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float64

from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps, StereoOptions, depth_bounds, find_depths
from sculpt_framework.multi_view_stereo.fusion import fuse_without_outlines
from sculpt_framework.multi_view_stereo.stereo_views import StereoViews, stereo_views
from sculpt_framework.posed_images.grab_cut import LEAST
from sculpt_framework.posed_images.plain_object import not_seen_through, with_cut_edges
from sculpt_framework.posed_images.plain_parts import agreed, grown
from sculpt_framework.posed_images.rough_masks import RoughMask, cut_masks, rough_masks
from sculpt_framework.posed_images.solid import CLEAR, Solid, cloud, fills_space, pieces
from sculpt_framework.posed_images.support import Plane, find_planes, goes_on
from sculpt_framework.shape_from_images.volume import Volume, whole_box
from sculpt_framework.spread import spread
from sculpt_framework.types import Box, Support, View

_AROUND = 2.0
"""How many times as wide as the box where the object is looked for is the space in which depths are found: what stands
behind the object shows where it ends."""
_WITHIN = 0.75
"""Of the distance of the nearest camera, how far that space reaches at most."""
_PIXELS = 128
"""Along the box in the images that are compared."""
_VIEWS = 48
"""That are compared at most, spread evenly."""
_NEIGHBOURS, _AGREEING = 8, 2
_SPACE_CELLS, _CELLS = 64, 160
"""Cells along the space of all depths, and along the box with some more around it in which the object is."""
_PLAIN_CELLS = 80
"""Along the same, where what has no depth is looked for by colours."""
_ONE_SIDED = 0.7
"""Length of the mean of the unit vectors to the cameras, from which on all are on one side of the object: cameras
around it come to 0.4 to 0.5, those of an arm that swings over it to more than 0.8."""
_LOOSE, _ROOMY = 0.8, 1.15
"""A box around the object, wider than it by the second, is looked into once more where it is narrower than this share
of the one that was looked into."""
_MORE = 1.2
_LESS = 0.5
"""Of the depths on a plane, so counted, that are on the object at least. It was 0.9 and more on tables and walls, and
0.2 on a brick that is a part of the object."""
_TOLD = 50_000
"""Of all depths, how many are handed on as points."""
_BURNT_OUT = 0.98
"""Brightness of a channel from which on it says only that there was much light."""
_KNOWN = 0.02
"""Share of the pixels that must have a depth."""
_MEANT = 0.25
"""Of all depths, by their nearness to the middles of the images, those on the object at least: photographs are taken of
it. Captures come to 0.36 and more, views that agree by chance to 0.02, and one image from everywhere to 0.16."""
_SURE, _SHOWN = 0.6, 0.85
"""Share of the masks in which what is nearest must have been seen, and of the images that must show it: else views
agree by chance."""
_CUT_AWAY = {
    1: "the plane it stands on is",
    2: "the planes it stands on and before are",
    3: "three planes around it are",
}
"""What is said of so many planes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundObject:
    train: list[View]
    """Those that show the object, with an alpha each."""
    test: list[View]
    said: str
    up: tuple[float, float, float] | None
    """The normal of the plane it stands on, unit, in world axes; None where none is cut away."""
    supports: tuple[Support, ...]
    """The planes that are cut away, world frame."""
    points: Float64[np.ndarray, "n 3"]
    """Places that the photographs show, of the object and of what is around it, world frame."""


def find_object(
    views: Sequence[View], test: Sequence[View], seed: Box, *, sure: bool = False, keep_support: bool = False
) -> FoundObject | str:
    """The views with an alpha each, or in words why no object is found. Views that have an alpha keep it.

    ``seed``, in the world frame, holds most of the object. Where it is not ``sure``, the object must end within it on
    most sides, unless with ``keep_support``, which leaves what it stands on.
    """
    given = (*views, *test)
    bare = sum(view.alpha is None for view in given)
    logging.getLogger("sculpt").info("%d images have no mask: looking for the object by depth", bare)
    search = _search(given, len(views), seed, sure=sure, keep_support=keep_support)
    if isinstance(search, str):
        return search
    if closer := _closer(search):
        # What is found coarsely but not in detail stays as it was found.
        again = _search(given, len(views), closer, sure=sure, keep_support=keep_support)
        search = search if isinstance(again, str) else again
    frame, posed, solid = search.frame, search.posed, search.solid
    stack = stereo_views([replace(view, alpha=None) for view in posed], _AROUND * _PIXELS / 2)
    one_sided = _one_sided(posed)
    rough = rough_masks(stack, len(posed), solid)
    share = _seen_of(rough)
    if share < _SURE:
        dense = None if one_sided or keep_support else not_seen_through(solid.volume, solid.maps, solid.known)
        if dense is None:
            return f"{solid.known}, but of what they make up only {100 * share:.0f} % is seen"
        solid = dense
        rough = rough_masks(stack, len(posed), solid)
    if solid.plain:
        outlines = with_cut_edges(given, posed, rough, stack, solid)
    else:
        outlines = rough if one_sided else _with_plain_parts(posed, rough, stack, solid)
    done = cut_masks(given, outlines, blind=one_sided)
    train = [view for view in done[: len(views)] if _shows(view)]
    # By depths alone it must be shown well enough, too: what colours add to a speck is no object.
    shown = min(len(train), sum(each.inside.mean() >= LEAST for each in rough[: len(views)]))
    if shown < _SHOWN * len(views):
        return f"{solid.known}, but only {shown} of {len(views)} images show what they make up"
    said = f"{bare} of {len(done)} images have no mask: the object is what they agree on in depth ({solid.known})"
    said += "; it is too plain for depths: it is what few views see through" if solid.plain else ""
    said += f"; {_CUT_AWAY[len(solid.planes)]} cut away (--dataset.keep-support leaves it)" if solid.planes else ""
    said += "; look at the masks: sculpt-data masks DIR."
    if len(train) < len(views):
        said += f" {len(views) - len(train)} images that do not show it are left out."
    points = cloud(solid.maps)[0]
    points = frame.to_world(torch.from_numpy(points[:: -(-len(points) // _TOLD)])).numpy()
    return FoundObject(
        train=train,
        test=done[len(views) :],
        said=said,
        up=_up(solid.planes, posed),
        supports=tuple(_support(plane, frame) for plane in solid.planes),
        points=points,
    )


def _support(plane: Plane, frame: Box) -> Support:
    """A plane of the cube's frame, whose axes are the world's, in world frame."""
    x, y, z = plane.normal.tolist()
    return Support(normal=(x, y, z), offset=float(plane.normal @ frame.to_world(torch.from_numpy(plane.point)).numpy()))


def _up(planes: Sequence[Plane], views: Sequence[View]) -> tuple[float, float, float] | None:
    """Of the plane the object stands on, in the cube's frame, whose axes are the world's. Of several it is the one that
    faces up: photographs are seldom taken upside down."""
    if not planes:
        return None
    upwards = -np.stack([view.camera.world_to_camera[1, :3].double().numpy() for view in views]).mean(axis=0)
    x, y, z = max(planes, key=lambda plane: float(plane.normal @ upwards)).normal.tolist()
    return (x, y, z)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Search:
    """What was found in a space."""

    frame: Box
    """The space."""
    posed: list[View]
    """All views, with cameras in its frame."""
    solid: Solid


def _search(given: Sequence[View], train: int, seed: Box, *, sure: bool, keep_support: bool) -> _Search | str:
    """By some of the first ``train`` views, in a space around the seed."""
    frame = _cube(seed)
    posed = [replace(view, camera=frame.camera_to_object(view.camera)) for view in given]
    solid = _solid(spread(posed[:train], _VIEWS), sure=sure, keep_support=keep_support)
    return solid if isinstance(solid, str) else _Search(frame=frame, posed=posed, solid=solid)


def _closer(search: _Search) -> Box | None:
    """A box around the object where the one it was looked for in is much wider: pixels and cells are shares of it."""
    cells, volume = np.argwhere(search.solid.inside), search.solid.volume
    low, high = (
        np.array(volume.origin) + volume.cell * corner for corner in (cells.min(axis=0), cells.max(axis=0) + 1)
    )
    half = _ROOMY * float((high - low).max()) / 2
    if half > _LOOSE / _AROUND:
        return None
    middle = (low + high) / 2
    low, high = (search.frame.to_world(torch.from_numpy(corner)) for corner in (middle - half, middle + half))
    return Box(minimum=low, maximum=high)


def _solid(views: Sequence[View], *, sure: bool, keep_support: bool) -> Solid | str:
    """What depths show of the object, or in words why that is none. Cameras in the frame of the cube."""
    reach = min([1.0, *(_WITHIN * float(view.camera.position.norm()) for view in views)])
    space = whole_box((1.0, 1.0, 1.0), _SPACE_CELLS)
    ball = np.linalg.norm(space.points, axis=1).astype(np.float32) - np.float32(reach)
    options = StereoOptions(pixels=round(_AROUND * _PIXELS), neighbours=_NEIGHBOURS, agreeing=_AGREEING, beyond=True)
    maps = _without_burnt_out(find_depths(views, space.holding(ball.reshape(space.shape)), options), views)
    known = f"depths at {100 * maps.known:.0f} % of the pixels of {len(maps.views)} views"
    if maps.known < _KNOWN:
        return f"only {known}: neighbouring views show little that is alike"
    half = _MORE / _AROUND
    volume, all_around = whole_box((half, half, half), _CELLS), not _one_sided(views)
    found = _what_has_depths(volume, maps, known, all_around=all_around, sure=sure, keep_support=keep_support)
    if isinstance(found, str) and all_around and not keep_support:
        return not_seen_through(volume, maps, known) or found
    return found


def _what_has_depths(
    volume: Volume, maps: DepthMaps, known: str, *, all_around: bool, sure: bool, keep_support: bool
) -> Solid | str:
    points, normals, aimed = cloud(maps)
    half = -float(volume.origin[0])
    shape, seen = fuse_without_outlines(volume, maps, all_around=all_around)
    planes = [] if keep_support else find_planes(points, normals, half)
    inside, own = pieces(shape, points, aimed, planes)
    while parts := [plane for plane in planes if _is_part(plane, points, aimed, own, half)]:
        planes.remove(parts[0])
        inside, own = pieces(shape, points, aimed, planes)
    meant = float(aimed[own].sum() / aimed.sum())
    if meant < _MEANT:
        return f"{known}, of which only {100 * meant:.1f} % are on something solid beside what it may stand on"
    if not keep_support and fills_space(inside, sure=sure):
        return f"{known}, but what they show fills the space: no object ends within it"
    return Solid(volume=volume, inside=inside, seen=seen, planes=planes, known=known, maps=maps)


def _without_burnt_out(maps: DepthMaps, views: Sequence[View]) -> DepthMaps:
    """Without depths where all channels are clipped: a table in glaring light would be taken for part of the object."""
    depths, confidence = maps.depths.copy(), maps.confidence.copy()
    for number, (given, (rows, columns)) in enumerate(zip(maps.views.given, maps.views.sizes.tolist(), strict=True)):
        clipped = (views[int(given)].rgb.numpy().min(axis=2) >= _BURNT_OUT).astype(np.float32)
        share = np.asarray(cv2.resize(clipped, (columns, rows), interpolation=cv2.INTER_AREA))
        for layer in (depths, confidence):
            layer[number, :rows, :columns][share > 0.5] = 0
    return replace(maps, depths=depths, confidence=confidence)


def _cube(seed: Box) -> Box:
    """Cubic, so that one unit of its frame is the half side of the space in which depths are found."""
    half = torch.full((3,), _AROUND * seed.scale, dtype=seed.center.dtype)
    return Box(minimum=seed.center - half, maximum=seed.center + half)


def _is_part(
    plane: Plane,
    points: Float64[np.ndarray, "n 3"],
    aimed: Float64[np.ndarray, " n"],
    own: Bool[np.ndarray, " n"],
    half: float,
) -> bool:
    """Whether a plane is a part of the object: it ends where that does, or is what the photographs are of, such as a
    front whose balconies would be the object else."""
    aside = aimed[own].sum() < _LESS * aimed[plane.holds(points, half)].sum()
    return bool(aside) or not goes_on(plane, points, points[own], half)


def _seen_of(rough: Sequence[RoughMask]) -> float:
    """Share of the masks in which what is nearest has been seen."""
    whole = sum(int(each.inside.sum()) for each in rough)
    return sum(int((each.inside & each.sure).sum()) for each in rough) / max(1, whole)


def _one_sided(views: Sequence[View]) -> bool:
    """Whether all are from one side: such views agree on too much behind the object and beside it."""
    ways = np.stack([view.camera.position.double().numpy() for view in views])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True).clip(min=1e-12)
    return bool(np.linalg.norm(ways.mean(axis=0)) > _ONE_SIDED)


def _with_plain_parts(
    views: Sequence[View], rough: Sequence[RoughMask], stack: StereoViews, solid: Solid
) -> list[RoughMask]:
    """The outlines with what else is the object by the colours of all views, above what it stands on."""
    showing = [number for number, each in enumerate(rough) if each.inside.any()]
    masks = grown([views[number] for number in showing], [rough[number].inside for number in showing])
    half = _MORE / _AROUND
    volume = whole_box((half, half, half), _PLAIN_CELLS)
    points = volume.points.astype(float)
    full = agreed(points, [views[number].camera for number in showing], masks)
    for plane in solid.planes:
        full &= plane.height(points) > CLEAR
    nearest, _ = depth_bounds(stack, full.reshape(volume.shape), volume)
    held = {int(given): nearest[i] > 0 for i, given in enumerate(stack.given)}
    out = list(rough)
    for number, mask in zip(showing, masks, strict=True):
        rows, columns = mask.shape
        more = mask & held[number][:rows, :columns]
        # As all views agree on some of what is between their outlines, it stays to be decided.
        out[number] = replace(rough[number], inside=rough[number].inside | more)
    return out


def _shows(view: View) -> bool:
    return view.alpha is not None and float(view.alpha.mean()) >= LEAST
