"""Alpha for images that have none: a constant background is found in the images' own borders and keyed out."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

Image = Float[np.ndarray, "h w 3"]
Color = Float[np.ndarray, " 3"]

# The object may reach the border in places; a background that fills less than this share of it is not trusted.
_BORDER_SHARE = 0.6
# Where something else fills more than the rest of most borders, it may as well be a stand or a cloth as the object.
_ALL_ROUND_SHARE = 0.95
# Sensor noise and JPEG blocks stay within this of the background; anything closer to it is taken as background.
_TOLERANCE = 0.04
# The same for a background that is exactly one colour, as renderers make it: three steps of 255.
_EXACT_TOLERANCE = 0.012
# Enclosed background (seen through a handle) counts from this share of the image on; specks are highlights.
_HOLE_SHARE = 2e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Background:
    color: Color
    """sRGB in [0, 1]."""
    tolerance: float
    """Largest difference in a channel that still is background."""


def common_background(images: Sequence[Image], lossless: bool, *, all_round: bool = False) -> Background | None:
    """The one colour behind all images; None if their borders do not agree on one.

    With ``all_round`` it must fill the border of most images, as it does around an object that is nowhere cut off.
    ``lossless`` says that the images never went through JPEG, whose errors are largest around the object.
    """
    rings = [_border(image) for image in images]
    colors = np.stack([np.median(ring, axis=0) for ring in rings])
    color = np.median(colors, axis=0)
    shares = [(np.abs(ring - color).max(axis=1) <= _TOLERANCE).mean() for ring in rings]
    if (np.array(shares) >= _BORDER_SHARE).mean() < 0.9:
        return None
    if all_round and np.median(shares) < _ALL_ROUND_SHARE:
        return None
    return given_background(color, images, lossless)


def given_background(color: Color, images: Sequence[Image], lossless: bool) -> Background:
    """A background of known colour, with the tolerance that the images' borders ask for."""
    errors = [np.abs(_border(image) - color).max(axis=1) for image in images]
    near = np.concatenate([error[error <= _TOLERANCE] for error in errors])
    exact = lossless and near.size > 0 and float(np.quantile(near, 0.99)) < 0.5 / 255
    return Background(color=color, tolerance=_EXACT_TOLERANCE if exact else _TOLERANCE)


def _border(image: Image) -> Float[np.ndarray, "n 3"]:
    """The outermost two pixels all around."""
    sides = (image[:2], image[-2:], image[:, :2], image[:, -2:])
    return np.concatenate([side.reshape(-1, 3) for side in sides])


def key_out(image: Image, background: Background) -> Float[np.ndarray, "h w"]:
    """Alpha of an image over a constant background; where it is neither 0 nor 1 the image gets its straight colour.

    That is done in place: hundreds of photographs are not to be in memory twice.

    Background is what looks like it and is connected to the border, or forms a large enough enclosed hole, so that an
    object's own spots of that colour stay. On the outline a pixel is taken as a mixture of the background and of the
    nearest colour inside; without that the outline would lie half a pixel too far outside.
    """
    behind = background.color.astype(image.dtype)
    similar = cv2.inRange(image, *(behind.astype(np.float64) + sign * background.tolerance for sign in (-1, 1))) > 0
    empty = _connected(similar)
    alpha = (~empty).astype(image.dtype)
    left, top, width, height = cv2.boundingRect((~empty).astype(np.uint8))
    around = slice(max(0, top - 1), top + height + 1), slice(max(0, left - 1), left + width + 1)
    _mix(image[around], alpha[around], behind)
    return alpha


def _mix(image: Image, alpha: Float[np.ndarray, "h w"], behind: Color) -> None:
    """Give the outline of what has an alpha, which is 0 or 1, the nearest colour inside and a share of that, in place.

    Outside of the image it goes on as it is at its border.
    """
    whole = alpha > 0
    solid = cv2.erode(whole.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    rim = whole & ~solid
    if not solid.any() or not rim.any():
        return
    inner = image[_nearest(solid, rim)]
    span = inner - behind
    share = ((image[rim] - behind) * span).sum(1) / np.maximum((span * span).sum(1), 1e-6)
    alpha[rim] = np.clip(share, 0, 1)
    image[rim] = inner


def _connected(similar: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The parts of ``similar`` that touch the border or are large."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats(similar.astype(np.uint8), connectivity=4)
    labels = np.asarray(parts, np.int32)
    height, width = similar.shape
    keep = stats[:, cv2.CC_STAT_AREA] >= max(16, _HOLE_SHARE * height * width)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    keep[np.unique(border)] = True
    keep[0] = False
    return keep[labels]


def _nearest(solid: Bool[np.ndarray, "h w"], wanted: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the solid pixels nearest to the wanted ones, these in row order."""
    empty = (~solid).astype(np.uint8)
    _, sources = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    labels, places = np.asarray(sources, np.int32), np.flatnonzero(solid)
    place = np.zeros(int(labels.max()) + 1, np.int64)
    place[labels.ravel()[places]] = places
    rows, columns = np.divmod(place[labels[wanted]], solid.shape[1])
    return rows, columns
