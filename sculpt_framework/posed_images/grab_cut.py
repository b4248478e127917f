"""GrabCut on reduced images: what a view's colours say where an outline is known roughly.

Rother, Kolmogorov, Blake: "GrabCut", SIGGRAPH 2004; the implementation is OpenCV's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, UInt8

from sculpt_framework.types import Camera, View

LEAST = 0.002
"""A mask of less than this share of the image shows nothing."""
_PIECE = 0.05
"""Pieces smaller than this share of the largest are specks."""
_ALONG, _STRIP = 640, 1.5
"""Longer side of the images that a rough outline is followed in, and half the width of the strip that is decided, in
pixels of the rough outline."""
_BLIND = 8
"""Pixels of the rough outline from an image's border within which hardly anything is measured: windows of coarse images
do not fit."""
_LEARNED = 2
"""Rounds in which a view's colours are learned."""
_EACH = 200
"""Pixels of each view that teach the others what the background looks like."""
_NEAR, _FEW = 24, 50
"""Half the side of the windows in which colours are learned once more, and how much object and background must be in
one at least; pixels."""
_ALIKE = 0.8
"""Share of the known pixels of a window that colours put on the right side, up to which they decide nothing there."""
Trimap = UInt8[np.ndarray, "h w"]
Mask = Bool[np.ndarray, "h w"]
Pixels = UInt8[np.ndarray, "h w 3"]
"""Blue, green, red."""
Samples = UInt8[np.ndarray, "n 1 3"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Colors:
    """Mixtures of five Gaussians each, as OpenCV packs them."""

    background: Float64[np.ndarray, "1 65"]
    object: Float64[np.ndarray, "1 65"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallView:
    """A view at the size of a cut."""

    image: Pixels
    camera: Camera


def cut(image: Pixels, trimap: Trimap, colors: Colors) -> Mask:
    if not _open(trimap).any():
        return trimap == cv2.GC_FGD
    known = Colors(background=colors.background.copy(), object=colors.object.copy())
    return without_specks(_decided(image, trimap, known, 1, cv2.GC_EVAL_FREEZE_MODEL))


def strip(start: Mask, wide: int, *, sure: Mask, possible: Mask, within: int | None = None) -> Trimap:
    """What may be decided within ``wide`` pixels of a mask's outline: outside of it is background, and so is what is
    not ``possible``; inside of it is the object where that is ``sure``, from ``within`` pixels on if that is given."""
    # The image's border is no outline: an object that is cut off there goes on.
    inner = cv2.erode((start & sure).astype(np.uint8), disk(wide if within is None else within), borderValue=1) > 0
    outer = (cv2.dilate(start.astype(np.uint8), disk(wide)) > 0) & possible
    trimap = np.where(start, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    trimap = np.where(outer, trimap, cv2.GC_BGD)
    return np.where(inner, cv2.GC_FGD, trimap).astype(np.uint8)


def learned_cut(
    image: Pixels,
    trimap: Trimap,
    rounds: int,
    *,
    margin: int | None = None,
    doubtful: Mask | None = None,
    background: Samples | None = None,
) -> Mask:
    """What looks like the object, by colours that are learned near what is to be decided: within ``margin`` pixels of
    it, or as many as suit its size. Before the first of the rounds, what is ``doubtful`` teaches nothing, as it would
    teach that it is what it is taken for, and samples of the ``background`` of other views teach as well."""
    window = window_of(trimap != cv2.GC_BGD, margin)
    teaching = np.ones_like(trimap[window], bool) if doubtful is None else ~doubtful[window]
    column, labels = image[window][teaching][:, None], trimap[window][teaching][:, None]
    if background is not None:
        column = np.concatenate([column, background])
        labels = np.concatenate([labels, np.full((len(background), 1), cv2.GC_BGD, np.uint8)])
    return _cut_by(image, trimap, _learned(column, labels), rounds, margin)


def _cut_by(image: Pixels, trimap: Trimap, colors: Colors, rounds: int, margin: int | None) -> Mask:
    """By colours that are learned from what is known alone, then also from what they decide; changed in place."""
    first = _decided(image, trimap, colors, 1, cv2.GC_EVAL_FREEZE_MODEL, margin)
    guessed = np.where(_open(trimap), np.where(first, cv2.GC_PR_FGD, cv2.GC_PR_BGD), trimap).astype(np.uint8)
    return _decided(image, guessed, colors, rounds - 1, cv2.GC_EVAL, margin)


def _learned(samples: Samples, labels: UInt8[np.ndarray, "n 1"]) -> Colors:
    # The clusters it starts from are drawn at random, from a generator of each thread.
    cv2.setRNGSeed(0)
    colors = Colors(background=np.zeros((1, 65)), object=np.zeros((1, 65)))
    samples, labels = np.ascontiguousarray(samples), labels.copy()
    cv2.grabCut(samples, labels, (0, 0, 1, 1), colors.background, colors.object, 0, cv2.GC_INIT_WITH_MASK)
    return colors


def _open(trimap: Trimap) -> Mask:
    """What is to be decided."""
    return (trimap == cv2.GC_PR_FGD) | (trimap == cv2.GC_PR_BGD)


def _decided(
    image: Pixels,
    trimap: Trimap,
    colors: Colors,
    rounds: int,
    mode: int,
    margin: int | None = None,
) -> Mask:
    """What GrabCut takes for the object; ``colors`` are changed in place."""
    window = window_of(trimap != cv2.GC_BGD, margin)
    pixels, inside = np.ascontiguousarray(image[window]), trimap[window].copy()
    cv2.grabCut(pixels, inside, (0, 0, 1, 1), colors.background, colors.object, rounds, mode)
    out = np.zeros(trimap.shape, bool)
    out[window] = (inside == cv2.GC_FGD) | (inside == cv2.GC_PR_FGD)
    return out


def window_of(open_at: Mask, margin: int | None = None) -> tuple[slice, slice]:
    """Rows and columns around what is to be decided, with so much around it, else as much background again as tells the
    two apart."""
    height, width = open_at.shape
    rows, columns = np.flatnonzero(open_at.any(axis=1)), np.flatnonzero(open_at.any(axis=0))
    if margin is None:
        margin = max(4, round(0.15 * max(rows[-1] - rows[0], columns[-1] - columns[0])))
    return (
        slice(max(0, rows[0] - margin), min(height, rows[-1] + 1 + margin)),
        slice(max(0, columns[0] - margin), min(width, columns[-1] + 1 + margin)),
    )


def without_specks(mask: Mask) -> Mask:
    """Without pieces, and without holes, that are small beside the largest piece."""
    for value in (True, False):
        _, labels, stats, _ = cv2.connectedComponentsWithStats((mask == value).astype(np.uint8), connectivity=4)
        sizes = stats[:, cv2.CC_STAT_AREA].copy()
        sizes[0] = 0
        largest = max(int(mask.sum()), 1) if not value else int(sizes.max(initial=0))
        small = sizes < _PIECE * largest if value else sizes < 0.2 * _PIECE * largest
        small[0] = False
        mask = np.where(small[labels], not value, mask)
    return mask


def reduced(view: View, side: int) -> SmallView:
    camera = view.camera
    factor = min(1.0, side / max(camera.width, camera.height))
    return resized(view, max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))


def resized(view: View, width: int, height: int) -> SmallView:
    image = np.asarray(cv2.resize(view.rgb.numpy(), (width, height), interpolation=cv2.INTER_AREA))
    pixels = np.ascontiguousarray(np.rint(image.clip(0, 1) * 255).astype(np.uint8)[:, :, ::-1])
    return SmallView(image=pixels, camera=view.camera.resized(width, height))


def masked(view: View, mask: Mask) -> View:
    """The view with a mask of any size as alpha; a step of a coarser mask becomes a slope."""
    camera = view.camera
    alpha: Float32[np.ndarray, "h w"] = mask.astype(np.float32)
    if alpha.shape != (camera.height, camera.width):
        alpha = cv2.resize(alpha, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
    return replace(view, alpha=torch.from_numpy(alpha))


@dataclass(frozen=True, kw_only=True, eq=False)
class RoughCut:
    """A view at the size of a cut, with what of it is to be decided."""

    image: Pixels
    trimap: Trimap
    doubtful: Mask
    """What teaches no colours: taken for the object, but not seen to be."""

    @property
    def inside(self) -> Mask:
        """What is inside of the rough outline."""
        return (self.trimap == cv2.GC_FGD) | (self.trimap == cv2.GC_PR_FGD)


def rough_cut(view: View, rough: Mask, sure: Mask, *, blind: bool) -> RoughCut:
    """Of some 640 pixels. Open is what is near the outline of a ``rough`` mask of any size, and where that is not
    ``sure``; where it is ``blind`` along the image's border, also what is there beside it."""
    small = reduced(view, _ALONG)
    height, width = small.image.shape[:2]
    if not rough.any():
        nothing = np.zeros((height, width), bool)
        return RoughCut(image=small.image, trimap=np.full_like(nothing, cv2.GC_BGD, np.uint8), doubtful=nothing)
    start, seen = (
        cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
        for mask in (rough, sure)
    )
    wide = max(1, int(_STRIP * width / rough.shape[1]))
    # Depths reach beyond outlines: beside what is not seen, nothing is sure either, and still less teaches.
    beside, near = (cv2.dilate((start & ~seen).astype(np.uint8), disk(radius)) > 0 for radius in (wide, 2 * wide))
    trimap = strip(start, wide, sure=~beside, possible=np.ones_like(start))
    if blind:
        far = int(_BLIND * width / rough.shape[1])
        border = np.ones_like(start)
        border[far : height - far, far : width - far] = False
        onwards = cv2.dilate((start & border).astype(np.uint8), disk(far)) > 0
        trimap = np.where(border & onwards & (trimap == cv2.GC_BGD), cv2.GC_PR_BGD, trimap).astype(np.uint8)
    return RoughCut(image=small.image, trimap=trimap, doubtful=start & near)


def background_of(cuts: Sequence[RoughCut]) -> Samples:
    """Some colours of what is background in each view, as samples: what a view with little of its own learns from."""
    samples = [np.zeros((0, 3), np.uint8)]
    for each in cuts:
        around = each.trimap == cv2.GC_BGD
        if not around.all():
            window = window_of(~around)
            pixels = each.image[window][around[window]]
            samples.append(pixels[:: max(1, len(pixels) // _EACH)])
    return np.concatenate(samples)[:, None]


def cut_along(rough: RoughCut, background: Samples) -> Mask:
    """A mask that follows edges and colours where that is open.

    Colours of object and background are learned in this view, near the outline, and not from what is not sure; those of
    the background from samples of other views as well. Where there is nothing of one of the two, or nothing to decide,
    the rough mask is right as it is.
    """
    trimap = rough.trimap
    without = not (trimap == cv2.GC_BGD).any() and not len(background)
    if without or not (trimap == cv2.GC_FGD).any() or not _open(trimap).any():
        return rough.inside
    found = learned_cut(rough.image, trimap, _LEARNED, doubtful=rough.doubtful, background=background)
    return _cut_near(rough, found)


def _cut_near(rough: RoughCut, found: Mask) -> Mask:
    """``found`` with what is near the rough outline decided by the colours beside it: in overlapping windows, each by
    what is in it, weighted by nearness to its middle. Where object and background are of the same colours, the rough
    outline stays."""
    start = rough.inside
    near = _open(rough.trimap) & ~rough.doubtful
    labels = np.where(rough.doubtful, np.where(found, cv2.GC_FGD, cv2.GC_BGD), rough.trimap).astype(np.uint8)
    height, width = labels.shape
    votes, weights = np.zeros((height, width)), np.zeros((height, width))
    hat = np.bartlett(2 * _NEAR + 2)[1:-1]
    for row in range(-_NEAR, height, _NEAR):
        for column in range(-_NEAR, width, _NEAR):
            rows, columns = (
                slice(max(0, at), min(end, at + 2 * _NEAR)) for at, end in ((row, height), (column, width))
            )
            window = rows, columns
            own = labels[window]
            if not near[window].any() or min((own == kind).sum() for kind in (cv2.GC_FGD, cv2.GC_BGD)) < _FEW:
                continue
            weight = np.outer(
                hat[rows.start - row : rows.stop - row], hat[columns.start - column : columns.stop - column]
            )
            image = rough.image[window]
            colors = _learned(image.reshape(-1, 1, 3), own.reshape(-1, 1))
            trust = max(0.0, _told_apart(image, own, colors) - _ALIKE) / (1 - _ALIKE)
            by_colors = _cut_by(image, own, colors, _LEARNED, 2 * _NEAR)
            votes[window] += weight * (trust * by_colors + (1 - trust) * start[window] - 0.5)
            weights[window] += weight
    decided = without_specks(np.where(near & (weights > 0), votes > 0, found))
    # A gap may be as small as a speck.
    return decided & (rough.trimap != cv2.GC_BGD)


def _told_apart(image: Pixels, trimap: Trimap, colors: Colors) -> float:
    """Share of what is known that colours put on the right side, pixel by pixel; the mean of object and background."""
    right = (
        _density(known, own) > _density(known, other)
        for known, own, other in (
            (image[trimap == cv2.GC_FGD], colors.object, colors.background),
            (image[trimap == cv2.GC_BGD], colors.background, colors.object),
        )
    )
    return float(np.mean([each.mean() for each in right]))


def _density(pixels: UInt8[np.ndarray, "n 3"], mixture: Float64[np.ndarray, "1 65"]) -> Float64[np.ndarray, " n"]:
    """Of a mixture, up to a factor that is the same for all."""
    shares, means, spreads = np.split(mixture[0], (5, 20))
    total = np.zeros(len(pixels))
    for share, mean, spread in zip(shares, means.reshape(5, 3), spreads.reshape(5, 3, 3), strict=True):
        if share > 0:
            # OpenCV keeps spreads from being singular; an absent cluster has a share of zero.
            off = pixels - mean
            distance = np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off)
            total += share * np.exp(-0.5 * np.maximum(distance, 0)) / np.sqrt(np.linalg.det(spread))
    return total


def disk(radius: int) -> UInt8[np.ndarray, "k k"]:
    """To erode or dilate by so many pixels."""
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)).astype(np.uint8)
