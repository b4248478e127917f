"""From depth maps to a signed distance: what is seen and what is seen through, weighed against each other everywhere.

The surface is the zero of the volume u that minimises (Zach, Pock and Bischof 2007, with Huber's norm for both parts)

    sum over cells of  |grad u|_a + w |u - f|_b,     u >= the visual hull's distance where that is positive.

f is the signed distance to what the views see, w how sure they are of it together. Where no view knows, f is the
distance to the shape known before, with little weight: there the surface bends as little as possible.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Int32
from scipy import ndimage

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps
from sculpt_framework.multi_view_stereo.gaps import bridged
from sculpt_framework.shape_from_images.missing import missing
from sculpt_framework.shape_from_images.volume import Volume, signed_distance

with kernel_cache("fusion", Path(__file__).with_name("fusion_kernels.py")):
    from sculpt_framework.multi_view_stereo import fusion_kernels as kernels

_FRONT, _BACK = 3.0, 2.0
"""Cells in front of and behind what a view sees in which it tells a distance. Behind less than in front: thin parts are
seen from both sides."""
_LOWEST = np.float32(-_BACK / _FRONT)
"""Of the values that are joined, in units of ``_FRONT``."""
_SURE, _SURE_EMPTY = 30.0, 4.0
"""Confidence of all views together after which more does not make a cell surer: near a surface, whose place each view
has a little wrong, and where they see through, in which a few are not wrong."""
_SEEN_THROUGH = 0.1
"""Weight from which on it is doubtful that a cell which is empty by what views see behind it is missing."""
_PRIOR = 0.05
"""Weight of the shape known before, relative to that of a cell that is sure."""
_HIDING, _HIDDEN = 2, 0.5
"""Without outlines: something must be seen in front of a place in more than so many images, and than such a share of
those it lies in, for it to be inside of something."""
_IN_SIGHT = 0.8
"""Without outlines: share of all images in which a place must lie that no view sees, or sees through, to be inside of
something plain. Beside it, what is behind shows in one image or another, if they are not all from one side."""
_DEEPER, _MISTAKEN = 6.0, 2
"""A view sees through a plain place where its depth is so many cells behind it; so many views may be wrong about that.
On a glazed jug a quarter of the pixels have depths, half of them more than a cell too deep, a tenth more than four."""
_SOFT_SLOPE, _SOFT_ERROR = 1.0, 0.1
"""Differences between cells, and to what is wanted, that count by their squares; beyond, linearly. In units of
``_FRONT``: the slope of a distance is a third."""
_STEPS = 100
_CRUMB = 1e-3
"""Pieces smaller than this share of the largest are mistakes."""


def fuse(solid: Volume, maps: DepthMaps) -> Volume:
    """The shape that the depth maps show within ``solid``, a signed distance, which bounds it from outside.

    In object units, negative inside. Gaps of the depth maps are bridged, which says more of plain and glossy places
    than the hull does. Bubbles inside, which no view can have seen, are filled, and crumbs removed.
    """
    unit = np.float32(_FRONT * solid.cell)
    before = np.clip(solid.values / unit, _LOWEST, 1)
    least = np.where(solid.values > 0, before, _LOWEST)
    # What no ray of a mask passes is outside; a little around it, for differences.
    told = bridged(maps, _BACK * solid.cell)
    wanted, weights, known = _told(solid, solid.values < unit, told, before, np.float32(_PRIOR))
    values = _smoothed(wanted, weights, least)
    views, depths, back = maps.views, maps.depths, _BACK * solid.cell
    doubtful = known & (wanted >= 1) & (weights >= _SEEN_THROUGH)
    asked = missing(values < 0, solid, views, depths, back, doubtful)
    if asked.any():
        filled = np.where(asked, _LOWEST, wanted), np.where(asked, np.float32(1), weights)
        values = np.minimum(values, _smoothed(*filled, least))
        # Smoothing takes away what is thinner than two cells, whatever it weighs. The hull bounds it well.
        values = np.where(missing(values < 0, solid, views, depths, back, doubtful), _LOWEST, values)
    inside = without_bubbles(values < 0)
    return solid.holding(signed_distance(inside, values * unit, solid.cell))


def fuse_without_outlines(
    space: Volume, maps: DepthMaps, *, all_around: bool
) -> tuple[Volume, Bool[np.ndarray, "x y z"]]:
    """The shape that the depth maps alone show where ``space`` is negative, in units of three cells, negative inside;
    and the cells near what some view sees.

    What no view sees is solid where something is seen in front of it in half of the images it lies in. With views from
    ``all_around`` it is also solid where it lies in four fifths of all images and none of them shows anything behind
    it: plain objects have no depths. It is empty elsewhere. Nothing is removed: there may be pieces of whatever else is
    in that space.
    """
    asked = space.values < 0
    hidden, _, shown = _sights(space, asked, maps)
    behind = hidden > np.maximum(_HIDING, _HIDDEN * shown)
    plain = (shown >= _IN_SIGHT * len(maps.views)) & all_around
    before = np.where(behind | plain, _LOWEST, np.float32(1))
    prior = np.where(hidden > 0, np.float32(2 * _PRIOR), np.float32(_PRIOR))
    least = np.where(asked, _LOWEST, np.float32(1))
    wanted, weights, known = _told(space, asked, maps, before, prior)
    return space.holding(_smoothed(wanted, weights, least)), known & (wanted < 1)


def dense_cells(space: Volume, maps: DepthMaps, reliable: Bool[np.ndarray, "n h w"]) -> Bool[np.ndarray, "x y z"]:
    """The cells that lie in four fifths of all images and that at most two views see through: of something plain that
    stands before what has depths, with views from all around, all of it and what it hides from them.

    Depths on something plain may be a few cells too deep; where they are ``reliable``, two cells are enough.
    """
    deeper = np.where(reliable & (maps.depths > 0), np.float32((_DEEPER - _BACK) * space.cell), np.float32(0))
    anywhere = np.ones(space.shape, bool)
    _, through, shown = _sights(space, anywhere, replace(maps, depths=maps.depths + deeper))
    return (shown >= _IN_SIGHT * len(maps.views)) & (through <= _MISTAKEN)


def _sights(
    space: Volume, asked: Bool[np.ndarray, "x y z"], maps: DepthMaps
) -> tuple[Int32[np.ndarray, "x y z"], Int32[np.ndarray, "x y z"], Int32[np.ndarray, "x y z"]]:
    """Views that see something ``_BACK`` cells in front of a cell, ``_DEEPER`` cells behind it, and that show it."""
    share_threads()
    views = maps.views
    hidden, through, shown = (np.zeros(space.shape, np.int32) for _ in range(3))
    kernels.count_sights(
        space.points, asked.reshape(-1), maps.depths, views.poses, views.lenses, views.sizes,
        np.float32(_BACK * space.cell), np.float32(_DEEPER * space.cell),
        hidden.reshape(-1), through.reshape(-1), shown.reshape(-1),
    )  # fmt: skip
    return hidden, through, shown


def _told(
    volume: Volume,
    asked: Bool[np.ndarray, "x y z"],
    maps: DepthMaps,
    before: Float32[np.ndarray, "x y z"],
    prior: Float32[np.ndarray, "#x #y #z"] | np.float32,
) -> tuple[Float32[np.ndarray, "x y z"], Float32[np.ndarray, "x y z"], Bool[np.ndarray, "x y z"]]:
    """What the views say, or what was known ``before`` where they say nothing, its weight, ``prior`` there, and
    where they say something."""
    share_threads()
    views = maps.views
    seen, sureness = np.zeros(volume.shape, np.float32), np.zeros(volume.shape, np.float32)
    kernels.vote(
        volume.points, asked.reshape(-1), maps.depths, maps.normals, maps.confidence, views.poses, views.lenses,
        np.float32(_FRONT * volume.cell), np.float32(_BACK * volume.cell), seen.reshape(-1), sureness.reshape(-1),
    )  # fmt: skip
    known = sureness > 0
    wanted = np.where(known, seen, before)
    enough = np.where(seen >= 1, np.float32(_SURE_EMPTY), np.float32(_SURE))
    weights = np.where(known, np.clip(sureness / enough, np.float32(_PRIOR), 1), prior)
    return wanted, weights.astype(np.float32), known


def _smoothed(
    wanted: Float32[np.ndarray, "x y z"], weights: Float32[np.ndarray, "x y z"], least: Float32[np.ndarray, "x y z"]
) -> Float32[np.ndarray, "x y z"]:
    """The minimum, by the primal-dual steps of Chambolle and Pock (2011)."""
    values = np.maximum(wanted, least)
    ahead, flow = values.copy(), np.zeros((*values.shape, 3), np.float32)
    # The norm of differences in three directions is the root of 12.
    step = np.float32(1 / np.sqrt(12))
    for _ in range(_STEPS):
        kernels.dual_step(ahead, flow, step, np.float32(_SOFT_SLOPE))
        kernels.primal_step(values, ahead, flow, wanted, weights, least, step, np.float32(_SOFT_ERROR))
    return values


def without_bubbles(inside: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """Without bubbles and without crumbs."""
    filled = np.asarray(ndimage.binary_fill_holes(inside), dtype=bool)
    piece = np.zeros(inside.shape, np.int32)
    ndimage.label(filled, output=piece)
    sizes = np.bincount(piece.reshape(-1))
    sizes[0] = 0
    return (sizes >= max(1, _CRUMB * sizes.max()))[piece]
