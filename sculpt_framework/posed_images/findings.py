"""What may be wrong with a scene's photographs and masks, said before an hour is spent on them."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float64

from sculpt_framework.posed_images.projected_box import box_outline
from sculpt_framework.posed_images.reading import in_short
from sculpt_framework.shape_from_images.windows import touches_border
from sculpt_framework.types import Box, Scene, View

_CUT_OFF = 0.2
"""Share of views in which the object may reach the border."""
_SMALL = 0.25
"""Of the image's shorter side: what the object should fill at least."""
_UNSEEN_DEGREES = 75.0
_OUTSIDE = 0.1
"""Share of a mask that may lie outside the box's outline."""
_BLURRED = 0.2
"""Detail, as a share of the median's, below which an image is taken for blurred."""
_DARKER = 0.6
"""Brightness of the object, as a share of the median's."""
_SIDE = 256
_DIRECTIONS = 2000


def findings(scene: Scene) -> list[str]:
    """One line for each thing that harms a reconstruction; none if nothing was found."""
    masked = [view for view in scene.train if view.alpha is not None]
    lines = [*_of_views(scene.train, scene.box)]
    if not masked:
        return ["no masks: the background is learned with the object; see 'sculpt-data masks'.", *lines]
    small = [(view, _mask(view)) for view in masked]
    cut = [view.name for view, mask in small if touches_border(mask)]
    if len(cut) > _CUT_OFF * len(masked):
        lines.append(f"{len(cut)} of {len(masked)} images cut the object off at their border ({in_short(cut)}).")
    sizes = [_extent(mask) for _, mask in small]
    if np.median(sizes) < _SMALL:
        lines.append(f"the object fills {100 * np.median(sizes):.0f} % of an image's side: go nearer or crop.")
    outside = [view.name for view, mask in small if _share_outside(view, mask, scene.box) > _OUTSIDE]
    if outside:
        lines.append(f"{len(outside)} masks reach out of the box: a wrong mask or camera ({in_short(outside)}).")
    return lines


def _of_views(views: Sequence[View], box: Box) -> list[str]:
    lines = []
    gap, where = widest_gap(views, box)
    if gap > _UNSEEN_DEGREES:
        direction = " ".join(f"{value:.2f}" for value in where)
        lines.append(
            f"nothing was photographed from within {gap:.0f} degrees of direction ({direction}): the surface there is "
            "made up."
        )
    detail = [_detail(view) for view in views]
    blurred = [view.name for view, value in zip(views, detail, strict=True) if value < _BLURRED * np.median(detail)]
    if blurred:
        lines.append(f"{len(blurred)} images are much less sharp than the rest ({in_short(blurred)}).")
    light = [_brightness(view) for view in views]
    dark = [view.name for view, value in zip(views, light, strict=True) if value < _DARKER * np.median(light)]
    if dark:
        lines.append(f"{len(dark)} images are much darker than the rest ({in_short(dark)}): exposure should be locked.")
    return lines


def widest_gap(views: Sequence[View], box: Box) -> tuple[float, Float64[np.ndarray, " 3"]]:
    """The direction, from the middle of the box, that is farthest from any camera's, and how far, in degrees."""
    middle = box.center.double().numpy()
    ways = np.stack([view.camera.position.double().numpy() - middle for view in views])
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
    # Evenly over the sphere, by the golden angle.
    number = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * number / _DIRECTIONS, np.pi * (1 + 5**0.5) * number
    wide = np.sqrt(1 - height * height)
    directions = np.stack([wide * np.cos(turn), wide * np.sin(turn), height], axis=1)
    nearest = (directions @ ways.T).max(axis=1)
    least = int(nearest.argmin())
    return float(np.degrees(np.arccos(nearest[least].clip(-1, 1)))), directions[least]


def _mask(view: View) -> np.ndarray:
    if view.alpha is None:
        raise ValueError("a view without a mask has none")
    factor = min(1.0, _SIDE / max(view.camera.width, view.camera.height))
    size = max(1, round(view.camera.width * factor)), max(1, round(view.camera.height * factor))
    return np.asarray(cv2.resize(view.alpha.numpy(), size, interpolation=cv2.INTER_AREA)) > 0.5


def _extent(mask: np.ndarray) -> float:
    """Longer side of the mask's rectangle over the image's shorter side."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return 0.0
    return float(max(np.ptp(rows) + 1, np.ptp(columns) + 1)) / min(mask.shape)


def _share_outside(view: View, mask: np.ndarray, box: Box) -> float:
    outline = box_outline(view.camera.resized(mask.shape[1], mask.shape[0]), box, 1.05)
    return float((mask & ~outline).sum() / max(1, mask.sum()))


def _grey(view: View) -> np.ndarray:
    factor = min(1.0, 2 * _SIDE / max(view.camera.width, view.camera.height))
    size = max(1, round(view.camera.width * factor)), max(1, round(view.camera.height * factor))
    return np.asarray(cv2.resize(view.rgb.mean(dim=2).numpy(), size, interpolation=cv2.INTER_AREA))


def _weight(view: View, shape: tuple[int, ...]) -> np.ndarray:
    """Where the object surely is: eroded, as an outline is sharp whatever the focus."""
    if view.alpha is None:
        return np.ones(shape, bool)
    mask = cv2.resize(view.alpha.numpy(), shape[::-1], interpolation=cv2.INTER_AREA)
    return cv2.erode((mask > 0.9).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def _detail(view: View) -> float:
    grey = _grey(view)
    inside = _weight(view, grey.shape)
    return float(np.abs(cv2.Laplacian(grey, cv2.CV_32F))[inside].mean()) if inside.any() else 0.0


def _brightness(view: View) -> float:
    grey = _grey(view)
    inside = _weight(view, grey.shape)
    return float(grey[inside].mean()) if inside.any() else 0.0
