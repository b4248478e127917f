"""Photographs made ready to be laid over each other: which pairs to compare, and images without mean and contrast."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from sculpt_framework.geometry.angles import angles_between
from sculpt_framework.types import Camera, View

_ANGLES, _BEST_ANGLE = (4.0, 25.0), 10.0
"""Degrees between the two ways from the object to the cameras: nearer ones tell little of depth, farther ones show the
same place in ways that differ too much to be matched."""
_WINDOW_SIGMA = 4.0
"""Of the Gaussian window in which mean and contrast are taken, in pixels of the prepared image."""
_TEXTURED = 0.2
"""Share of the image's own contrast from which on a place has texture."""
_GREY_STEP = 1 / 255
"""Contrast that 8 bits can make on their own."""
_MARGIN = 8
"""Pixels kept around a mask."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedImage:
    """A photograph, cut to its mask, as it is compared with others."""

    camera: Camera
    """In world frame, for the pixels of these arrays."""
    normalised: Float32[np.ndarray, "h w"]
    """Brightness less its local mean, over local contrast; 0 outside the mask. Gain and offset are gone."""
    scale: float
    """Side of a pixel of the view in pixels of these arrays, at most 1."""
    mask: Bool[np.ndarray, "h w"]
    """Pixels of the object; all where the view has no alpha."""
    textured: Bool[np.ndarray, "h w"]
    """Pixels of the mask with enough contrast around them to tell where they are."""


def prepare(view: View, pixels_at_most: int | None) -> PreparedImage:
    """One view, made smaller where it has more pixels than ``pixels_at_most``."""
    pixels = view.camera.width * view.camera.height
    scale = 1.0 if pixels_at_most is None else min(1.0, (pixels_at_most / pixels) ** 0.5)
    camera, grey = view.camera, np.ascontiguousarray(view.rgb.numpy().mean(axis=2), np.float32)
    alpha = np.ones(grey.shape, np.float32) if view.alpha is None else view.alpha.numpy().astype(np.float32)
    if scale < 1:
        camera = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        size = (camera.width, camera.height)
        grey, alpha = (np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)) for image in (grey, alpha))
    left, top, right, bottom = _window(alpha > 0.5)
    grey, mask = grey[top:bottom, left:right], alpha[top:bottom, left:right] > 0.5
    normalised, textured = normalise(grey, mask)
    camera = camera.crop(left, top, right - left, bottom - top)
    return PreparedImage(camera=camera, normalised=normalised, scale=scale, mask=mask, textured=textured)


def normalise(
    grey: Float32[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]
) -> tuple[Float32[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Take local mean and contrast out of the pixels of a mask, and say which of them have texture.

    What is left is the same for a x grey + b. Slopes count as little as offsets do: only what a slope does not explain
    is contrast.
    """
    inside = mask.astype(np.float32)
    weight = np.maximum(_blur(inside), np.float32(1e-3))
    detail = inside * (grey - _blur(inside * grey) / weight)
    variance = np.maximum(_blur(detail * detail) / weight, 0)
    usual = float(np.sqrt(variance[mask].mean())) if mask.any() else 0.0
    floor = max(_TEXTURED * usual, _GREY_STEP)
    normalised = detail / np.sqrt(variance + np.float32(floor * floor))
    return normalised, mask & (variance > floor * floor)


def choose_pairs(
    cameras: Sequence[Camera], center: Float64[np.ndarray, " 3"], at_most: int | None
) -> list[tuple[int, int]]:
    """Pairs of a camera and its partner: the one nearest to the best angle as seen from ``center``, world frame.

    A camera without another at a useful angle comes first in no pair. Of more than ``at_most`` pairs some are taken,
    spread evenly over the cameras.
    """
    ways = np.array([camera.position.double().numpy() for camera in cameras]).reshape(-1, 3) - center
    degrees = angles_between(ways)
    useful = (degrees >= _ANGLES[0]) & (degrees <= _ANGLES[1])
    partner = np.argmin(np.where(useful, np.abs(degrees - _BEST_ANGLE), np.inf), axis=1) if len(cameras) else []
    pairs = [(i, int(j)) for i, j in enumerate(partner) if useful[i, j]]
    count = len(pairs) if at_most is None else min(len(pairs), at_most)
    return [pairs[number * len(pairs) // count] for number in range(count)]


def _blur(image: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), _WINDOW_SIGMA, borderType=cv2.BORDER_CONSTANT))


def _window(mask: Bool[np.ndarray, "h w"]) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of what holds the mask, with a margin; the whole image where the mask is empty."""
    height, width = mask.shape
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if len(rows) == 0:
        return 0, 0, width, height
    left, top = max(0, int(columns[0]) - _MARGIN), max(0, int(rows[0]) - _MARGIN)
    return left, top, min(width, int(columns[-1]) + 1 + _MARGIN), min(height, int(rows[-1]) + 1 + _MARGIN)
