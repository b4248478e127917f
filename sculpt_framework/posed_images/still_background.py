"""A background that stands still while the object turns before it.

On a turntable, camera and background often stay as they are. A pixel then has the same colour in all photographs in
which the object does not cover it. Where it has that colour it shows the background, else the object. That holds in the
shade and in narrow gaps through which a wall is seen, too, where depths and learned colours say little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32, Int64, Num

from sculpt_framework.posed_images.grab_cut import Mask, Pixels, RoughCut
from sculpt_framework.spread import spread
from sculpt_framework.types import Camera

_SMALL = 160
"""Longer side of the images that are searched for those with the same background."""
_SHIFTED, _STILL = 0.05, 3.0
"""Two images of a still background differ so many times as much once one is moved by this share of its width."""
_TURNED = 30.0
"""Degrees by which some of their cameras must be turned: frames of a video that hardly moves are alike, too."""
_FEWEST, _MOST = 2, 48
"""Images that must show a pixel without the object, and how many are compared at most."""
_SAME, _OTHER, _STEADY = 2.0, 3.0, 2.0
"""In units of the noise: up to where the mean of a window shows the background, from where on a pixel hides it, and how
much a pixel of the background may vary to tell anything."""
_EDGE = 0.3
"""Share of the difference between background and object at which a pixel on the edge is the object's. Less than a half:
objects are darker or paler there, as they turn away."""
_WINDOW, _BESIDE = 3, 5
"""Sides of the windows that are compared, and of those that tell what is beside a pixel."""
_LIKE, _UNLIKE = 0.03, 0.01
"""Share of the known object that may look like the background, as closed gaps do, and of the known background that may
look unlike it, as moving shadows do."""
_ROUNDS = 3
"""What shows the background in a gap tells where else it is seen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Still:
    """What several images share."""

    colors: Float32[np.ndarray, "h w 3"]
    steady: Mask
    """Where the colours are known and hardly vary."""
    noise: float
    """Median deviation from the colours, in steps of 255, mean of the channels."""


def with_still_background(cuts: Sequence[RoughCut], cameras: Sequence[Camera]) -> list[RoughCut]:
    """Cuts in which what shows a still background is decided to be background, and what hides it near an outline to be
    the object.

    Cuts stay as they are where images do not share a background, and where the object looks like it.
    """
    out = list(cuts)
    for group in _groups(cuts, cameras):
        own = [cuts[index] for index in group]
        for _ in range(_ROUNDS):
            own = _told(own, _still(spread(own, _MOST)))
        for index, each in zip(group, own, strict=True):
            out[index] = each
    return out


def _groups(cuts: Sequence[RoughCut], cameras: Sequence[Camera]) -> list[list[int]]:
    """Which images show the same background from cameras that are turned; each is in one group at most."""
    small = [_reduced(each) for each in cuts]
    ways = np.stack([camera.world_to_camera[2, :3].double().numpy() for camera in cameras])
    groups, left = [], list(range(len(cuts)))
    while left:
        group = [left[0], *(index for index in left[1:] if _alike(small[left[0]], small[index]))]
        if (ways[group] @ ways[group[0]]).min() < np.cos(np.radians(_TURNED)):
            groups.append(group)
        left = [index for index in left if index not in group]
    return groups


@dataclass(frozen=True, kw_only=True, eq=False)
class _Small:
    image: Float32[np.ndarray, "h w 3"]
    free: Mask
    """What shows nothing of the object."""
    full: tuple[int, ...]
    """Rows and columns before it was reduced."""


def _reduced(cut: RoughCut) -> _Small:
    height, width = cut.trimap.shape
    factor = min(1.0, _SMALL / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    layers = cut.image.astype(np.float32), (cut.trimap != cv2.GC_BGD).astype(np.float32)
    image, covered = (np.asarray(cv2.resize(layer, size, interpolation=cv2.INTER_AREA)) for layer in layers)
    return _Small(image=image, free=covered == 0, full=cut.trimap.shape)


def _alike(one: _Small, other: _Small) -> bool:
    if one.full != other.full:
        return False
    far = max(1, round(_SHIFTED * one.image.shape[1]))
    free, moved = one.free & other.free, one.free[:, far:] & other.free[:, :-far]
    if not free.any() or not moved.any():
        return False
    there = float(np.median(_off(one.image, other.image)[free]))
    # Plain surroundings look the same wherever they are: they tell nothing.
    return _STILL * there < float(np.median(_off(one.image[:, far:], other.image[:, :-far])[moved]))


def _off(one: Num[np.ndarray, "h w 3"], other: Num[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    return np.abs(one.astype(np.float32) - other).mean(axis=2)


def _still(cuts: Sequence[RoughCut]) -> _Still:
    """Medians over the images in which nothing covers a pixel."""
    covered = np.stack([each.trimap != cv2.GC_BGD for each in cuts])
    images = np.stack([each.image for each in cuts])
    free = (~covered).sum(axis=0)
    middle, most = ((free - 1) // 2).clip(min=0), 2 * free // 3
    channels = [_ranked(np.where(covered, np.uint8(255), images[..., channel]), middle) for channel in range(3)]
    colors = np.stack(channels, axis=-1).astype(np.float32)
    off = np.stack([_off(image, colors) for image in images])
    varies = _ranked(np.where(covered, np.float32(np.inf), off), most)
    known = free >= _FEWEST
    # Colours are whole numbers: less than a step is no measurement of noise.
    noise = max(1.0, float(np.median(varies[known]))) if known.any() else 1.0
    return _Still(colors=colors, steady=known & (varies <= _STEADY * noise), noise=noise)


def _ranked(values: Num[np.ndarray, "n h w"], rank: Int64[np.ndarray, "h w"]) -> Num[np.ndarray, "h w"]:
    return np.take_along_axis(np.sort(values, axis=0), rank[None], axis=0)[0]


def _told(cuts: Sequence[RoughCut], still: _Still) -> list[RoughCut]:
    """Decided by the background as far as it tells the known object from the known background."""
    shows, hides = zip(*(_compared(each.image, still) for each in cuts), strict=True)
    by_same = _share(shows, cuts, cv2.GC_FGD, still.steady) <= _LIKE
    by_other = _share(hides, cuts, cv2.GC_BGD, still.steady) <= _UNLIKE
    out = []
    for each, same, other in zip(cuts, shows, hides, strict=True):
        trimap = each.trimap.copy()
        if by_same:
            beside = cv2.dilate(same.astype(np.uint8), np.ones((_BESIDE, _BESIDE), np.uint8)) > 0
            trimap[beside & (trimap == cv2.GC_FGD)] = cv2.GC_PR_FGD
            trimap[same] = cv2.GC_BGD
        if by_other:
            trimap[other & (trimap != cv2.GC_BGD)] = cv2.GC_FGD
        out.append(replace(each, trimap=trimap))
    return out


def _compared(image: Pixels, still: _Still) -> tuple[Mask, Mask]:
    """What shows the background, and what hides it; neither where that is not known."""
    off = _off(image, still.colors)
    same = cv2.blur(np.where(still.steady, off, np.float32(255)), (_WINDOW, _WINDOW)) < _SAME * still.noise
    hidden = still.steady & (off > _OTHER * still.noise)
    inner = cv2.erode(hidden.astype(np.float32), np.ones((_WINDOW, _WINDOW), np.uint8), borderValue=0)
    count, total = (cv2.blur(layer, (_BESIDE, _BESIDE)) for layer in (inner, inner * off))
    return same, hidden & (count > 0) & (off * count > _EDGE * total)


def _share(told: Sequence[Mask], cuts: Sequence[RoughCut], kind: int, steady: Mask) -> float:
    """Of what is known to be of that kind where the background is known, how much is told so."""
    known = [(each.trimap == kind) & steady for each in cuts]
    wrong = sum(int((one & other).sum()) for one, other in zip(told, known, strict=True))
    return wrong / max(1, sum(int(each.sum()) for each in known))
