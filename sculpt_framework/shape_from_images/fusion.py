"""From depth maps to a signed distance: what views see through is empty, and what none knows stays as it was."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32
from scipy import ndimage

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.shape_from_images.depth_maps import DepthMaps
from sculpt_framework.shape_from_images.missing import missing
from sculpt_framework.shape_from_images.packing import PackedViews
from sculpt_framework.shape_from_images.volume import Volume, signed_distance

with kernel_cache("sweep", Path(__file__).with_name("sweep_kernels.py")):
    from sculpt_framework.shape_from_images.sweep_kernels import fuse, relax

_GRAIN = 128
"""Cells along the longest side of the box for which the numbers of cells below are meant. In finer volumes they are as
many more: what depths err by, and how narrow the openings into a false hollow are, does not shrink with the cells."""
_TRUNCATION = 3.0
"""Cells within which a depth speaks of a surface."""
_SURE = 8.0
"""Views after which more of them do not make a value surer."""
_PRIOR = 0.02
"""Weight of the shape known before, relative to that of a value that is sure."""
_STIFFNESS = 0.3
"""Pull of the six neighbours, relative to that of a value that is sure: fills what no view knows, smoothly."""
_SWEEPS = 100
_DOUBT = 5.0
"""Margins that are added to the margin where no view tells of a cell; where its value is sure, none are."""
_THIN = 2.0
"""Cells behind a place from which on a depth there says that it is seen through."""
_NOISE = 0.02
"""Length of the colours' gradient, per pixel, that says as much of a place as sampling and noise do."""
_WIDE = 1000
"""Cells of a hollow from which on it is no pit, however shallow."""
_CRUMB = 1e-3
"""Pieces smaller than this share of the largest are mistakes."""


def carve(solid: Volume, views: PackedViews, maps: DepthMaps, margin: float) -> Volume:
    """The volume's shape without what the depth maps see through, as a signed distance in object units.

    ``solid`` is a signed distance. What depths show less than ``margin`` below its surface is left alone, as depths are
    no more exact than that; from twice as deep on they are believed as they are. What is left after all depths are
    believed decides which of them would have to see through it: those are not. Pits that few views or plain colours
    tell of and bubbles inside are filled, and so is what masks show and nothing is left of; crumbs outside are removed.
    """
    hull = solid.values < 0
    sums = _Sums(*(np.zeros(hull.shape, kind) for kind in (np.float32, np.float32, np.float32, bool)))
    telling = _telling(views)
    _add_up(solid, hull, np.zeros((0, 0, 0), bool), views, maps, telling, sums)
    carved = _carved(solid, _filled(solid, sums), margin)
    # Without its skin, which a line of sight along the surface may touch.
    left = np.asarray(ndimage.binary_erosion(carved < 0), dtype=bool)
    _add_up(solid, sums.seen_through.copy(), left, views, maps, telling, sums)
    carved = _without_pits(solid, hull, sums, margin)
    narrow = round(_grains(solid))
    open_parts = missing(carved < 0, solid, views, maps.depths, _THIN * narrow * solid.cell)
    carved = np.where(open_parts, solid.values, carved)
    inside = one_piece(carved < 0, hull, narrow)
    return solid.holding(signed_distance(inside, carved, solid.cell))


class _Sums(NamedTuple):
    """Of what the maps say of cells."""

    distance: Float32[np.ndarray, "x y z"]
    """To what is seen, cut at the truncation, over the views that say something."""
    views: Float32[np.ndarray, "x y z"]
    told: Float32[np.ndarray, "x y z"]
    """Over these views, how much the colours there tell of a place, from 0 to 1."""
    seen_through: Bool[np.ndarray, "x y z"]
    """Whether a view sees beyond the truncation here."""


def _telling(views: PackedViews) -> Float32[np.ndarray, "v h w"]:
    """How much the colours around a pixel tell of a place, from 0 on a plain surface to 1.

    The variance of a match is that of the noise over the square of the gradient, here the mean over 3 x 3 pixels. The
    outline moves over the surface from view to view, so pixels next to it tell nothing.
    """
    telling = np.zeros(views.inside.shape, np.float32)
    for image, inside, out in zip(views.colors, views.inside, telling, strict=True):
        steps = [cv2.Sobel(image, cv2.CV_32F, x, 1 - x, scale=1 / 8) for x in (0, 1)]
        square = cv2.blur(np.square(steps).sum(axis=(0, 3)), (3, 3))
        # As far as the gradients of 3 x 3 pixels reach.
        interior = cv2.erode(inside.astype(np.float32), np.ones((5, 5)), borderType=cv2.BORDER_CONSTANT, borderValue=0)
        out[:] = interior * square / (square + np.float32(_NOISE**2))
    return telling


def _add_up(
    solid: Volume,
    wanted: Bool[np.ndarray, "x y z"],
    blocked: Bool[np.ndarray, "x2 y2 z2"],
    views: PackedViews,
    maps: DepthMaps,
    telling: Float32[np.ndarray, "v h w"],
    sums: _Sums,
) -> None:
    """Make the sums of these cells anew, believing no depth that sees through ``blocked`` cells, if there are any."""
    fuse(
        solid.points,
        wanted.reshape(-1),
        maps.depths,
        telling,
        views.poses,
        views.lenses,
        views.positions,
        truncation_of(solid),
        blocked,
        np.array(solid.origin, np.float32),
        np.float32(solid.cell),
        *(each.reshape(-1) for each in sums),
    )


def _filled(solid: Volume, sums: _Sums) -> Float32[np.ndarray, "x y z"]:
    """Distance to what the maps show, from the shape known before where no view knows."""
    truncation = truncation_of(solid)
    prior = np.clip(solid.values, -truncation, truncation)
    return _fill(sums.distance / np.maximum(sums.views, 1), _sureness(sums.views), prior)


def _sureness(views: Float32[np.ndarray, "x y z"]) -> Float32[np.ndarray, "x y z"]:
    """From 0, where no view says anything, to 1."""
    return np.minimum(views, np.float32(_SURE)) / np.float32(_SURE)


def _grains(solid: Volume) -> float:
    """Cells along one cell of ``_GRAIN``, at least 1."""
    return max(1.0, (max(solid.shape) - 2) / _GRAIN)


def truncation_of(solid: Volume) -> np.float32:
    """How far from a surface a depth speaks of it, in units of the volume: no less where cells are fine."""
    return np.float32(_TRUNCATION * _grains(solid) * solid.cell)


def _carved(
    solid: Volume, seen: Float32[np.ndarray, "x y z"], margin: float | Float32[np.ndarray, "x y z"]
) -> Float32[np.ndarray, "x y z"]:
    deeper = seen - solid.values
    share = np.clip(deeper / np.maximum(margin, 1e-6, dtype=np.float32) - 1, 0, 1)
    return solid.values + share * deeper


def _without_pits(
    solid: Volume, hull: Bool[np.ndarray, "x y z"], sums: _Sums, margin: float
) -> Float32[np.ndarray, "x y z"]:
    """What depths carve, without the hollows that are shallow for how little tells of them.

    The fewer views see a place, the more grazing they look, and the more their depths err together; on a plain surface
    many agree on a wrong depth, as any matches. Widening the margin for all they say would fill the deep, narrow
    hollows as well, which few views see either. So a hollow, which is what hangs together by the faces of its cells, is
    left as it is if any of its cells is carved with the wider margin, too, or if it is wide.
    """
    seen = _filled(solid, sums)
    carved = _carved(solid, seen, margin)
    cautious = _carved(solid, seen, np.float32(margin) * (1 + np.float32(_DOUBT) * (1 - _sureness(sums.told))))
    hollows = hull & (carved >= 0)
    piece = _pieces(hollows)
    sizes = np.bincount(piece.reshape(-1))
    deep = np.bincount(piece[hollows & (cautious >= 0)], minlength=len(sizes)) > 0
    pits = hollows & ~(deep | (sizes >= _WIDE * _grains(solid) ** 3))[piece]
    # The distance is bent towards a pit in the cells round it as well.
    bent = np.asarray(ndimage.binary_dilation(pits, iterations=round(2 * _grains(solid))), dtype=bool)
    around = bent & (pits | ~hollows)
    return np.where(around, cautious, carved)


def _pieces(cells: Bool[np.ndarray, "x y z"]) -> Int32[np.ndarray, "x y z"]:
    """The number, from 1 on, of what hangs together by the faces of its cells; 0 elsewhere."""
    piece = np.zeros(cells.shape, np.int32)
    ndimage.label(cells, output=piece)
    return piece


def _fill(
    value: Float32[np.ndarray, "x y z"], weight: Float32[np.ndarray, "x y z"], prior: Float32[np.ndarray, "x y z"]
) -> Float32[np.ndarray, "x y z"]:
    """Minimise weight (phi - value)^2 + _PRIOR (phi - prior)^2 + _STIFFNESS (steps between cells)^2, by Jacobi."""
    phi = np.where(weight > 0, value, prior).astype(np.float32)
    wanted = weight * value + np.float32(_PRIOR) * prior
    share = np.float32(1) / (weight + np.float32(_PRIOR + _STIFFNESS))
    share_threads()
    spare = np.empty_like(phi)
    for _ in range(_SWEEPS):
        relax(phi, wanted, share, np.float32(_STIFFNESS / 6), spare)
        phi, spare = spare, phi
    return phi


def one_piece(
    inside: Bool[np.ndarray, "x y z"], hull: Bool[np.ndarray, "x y z"], narrow: int
) -> Bool[np.ndarray, "x y z"]:
    """Without bubbles and without crumbs. A bubble is what hangs together with the outside of the ``hull``, if at all,
    only through openings less than 2 ``narrow`` + 1 cells wide: hollows of this kind come from highlights, whose depths
    lie inside."""
    hull = np.asarray(ndimage.binary_fill_holes(hull), dtype=bool)
    wide = np.asarray(ndimage.binary_erosion(~inside, border_value=1, iterations=narrow), dtype=bool)
    piece = _pieces(wide)
    outside = np.bincount(piece[wide & ~hull], minlength=int(piece.max()) + 1) > 0
    open_space = np.asarray(ndimage.binary_dilation(outside[piece], mask=~inside, iterations=narrow), dtype=bool)
    solid = hull & ~open_space
    piece = _pieces(solid)
    sizes = np.bincount(piece.reshape(-1))
    sizes[0] = 0
    return (sizes >= max(1, _CRUMB * sizes.max()))[piece]
