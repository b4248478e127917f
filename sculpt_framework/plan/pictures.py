"""What single images say: how fine their texture is, how thin the object gets, which of them repeat each other."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sculpt_framework.shape_from_images.windows import touches_border
from sculpt_framework.types import Box, View

Grey = Float[np.ndarray, "h w"]
Mask = Bool[np.ndarray, "h w"]

WIDTHS = (2.0, 4.0, 8.0, 16.0)
"""Pixels: texture finer than each of these is measured."""
THIN = (2, 3, 4, 6, 8, 12, 16)
"""Pixels: whether parts of the object are thinner than each of these is looked for."""
_SIDE = 64
"""Pixels that images are reduced to before they are compared with each other."""
_SAME_PLACE = 2e-3
"""Cameras nearer to each other than this, by their distance from the object, and turned alike to as many radians, stand
at the same place."""
_SAME_COLOR = 0.01
"""Mean difference of colours, in [0, 1], up to which two images from one place show the same."""
_OBJECT_PIXELS = 4
"""An image that shows fewer pixels of the object than this shows nothing."""
_SPEAKING_SIDE = 96
_SPEAKING = 0.01
"""Standard deviation of brightness over 3x3 pixels from which neighbouring views can be compared there."""


def is_cut(view: View) -> bool:
    """Whether the object goes on beyond the border of the image."""
    return view.alpha is not None and touches_border(view.alpha > 0.5)


def contrast(view: View) -> tuple[float, ...]:
    """For each of ``WIDTHS`` the root mean square of what brightness (0 to 1) has finer than that, on the object."""
    grey, mask = _object(view)
    inner = _eroded(mask, 2)
    if not inner.any():
        return tuple(0.0 for _ in WIDTHS)
    weight = mask.astype(np.float32)
    out = []
    for width in WIDTHS:
        # Divided by what the blur has of the object, so that its outline is no texture.
        smooth = _blur(grey * weight, 0.5 * width) / np.maximum(_blur(weight, 0.5 * width), 1e-3)
        out.append(float(np.sqrt(np.mean(np.square(grey - smooth)[inner]))))
    return tuple(out)


def speaking(view: View) -> float:
    """Share of the object's pixels, its longer side being 96 of them, whose surroundings stereo could tell apart."""
    grey, mask = _object(view)
    factor = min(1.0, _SPEAKING_SIDE / max(grey.shape))
    size = max(3, round(grey.shape[1] * factor)), max(3, round(grey.shape[0] * factor))
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
    inner = _eroded(np.asarray(cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)) > 0.99, 1)
    if not inner.any():
        return 0.0
    mean = cv2.blur(small, (3, 3))
    deviation = np.sqrt(np.maximum(cv2.blur(small * small, (3, 3)) - mean * mean, 0))
    return float((deviation[inner] > _SPEAKING).mean())


def thinnest(view: View) -> int | None:
    """Pixels: the smallest of ``THIN`` below which some longish part of the silhouette is wide; None if none is."""
    if view.alpha is None:
        return None
    mask = _object(view)[1].astype(np.uint8)
    for width in THIN:
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width + 1, width + 1))
        # A border of nothing, so that what the image cuts off is not taken for thin.
        opened = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, disc, borderType=cv2.BORDER_REPLICATE))
        lost = np.where(opened > 0, np.uint8(0), mask)
        _, _, stats, _ = cv2.connectedComponentsWithStats(lost, connectivity=8)
        # Corners are lost to any disc, and a row of pixels where an outline runs along the rows; a thin part is longer
        # than it is wide, and wider than that.
        extent = np.maximum(stats[1:, cv2.CC_STAT_WIDTH], stats[1:, cv2.CC_STAT_HEIGHT])
        long, full = extent >= 3 * width, stats[1:, cv2.CC_STAT_AREA] >= 0.6 * width * extent
        if bool((long & full).any()):
            return width
    return None


def blind_views(views: Sequence[View], box: Box) -> tuple[str, ...]:
    """Names of views that show nothing of the object: an empty mask, or a box that is out of their sight."""
    return tuple(view.name for view in views if not _sees(view, box))


def repeated_views(views: Sequence[View], box: Box) -> tuple[tuple[str, str], ...]:
    """Pairs of a view and an earlier one that it repeats: same place, same direction, same lens, same picture."""
    places = np.stack([view.camera.position.double().numpy() for view in views])
    turns = np.stack([view.camera.world_to_camera[:3, :3].double().numpy() for view in views])
    reach = np.linalg.norm(places - box.center.double().numpy(), axis=1)
    lenses = np.array([[v.camera.fx, v.camera.fy, v.camera.cx, v.camera.cy] for v in views])
    small: dict[int, np.ndarray] = {}
    pairs: list[tuple[str, str]] = []
    kept: list[int] = []
    for index in range(len(views)):
        near = [
            other
            for other in kept
            if np.linalg.norm(places[index] - places[other]) < _SAME_PLACE * reach[index]
            and np.abs(turns[index] - turns[other]).max() < _SAME_PLACE
            and np.allclose(lenses[index], lenses[other], rtol=_SAME_PLACE)
            and views[index].rgb.shape == views[other].rgb.shape
        ]
        if near:
            small |= {known: _tiny(views[known]) for known in (index, *near) if known not in small}
        twin = next((other for other in near if np.abs(small[index] - small[other]).mean() < _SAME_COLOR), None)
        if twin is None:
            kept.append(index)
        else:
            pairs.append((views[index].name, views[twin].name))
    return tuple(pairs)


def _sees(view: View, box: Box) -> bool:
    if view.alpha is not None:
        return int((view.alpha > 0.5).sum()) >= _OBJECT_PIXELS
    low, high = box.minimum.double().numpy(), box.maximum.double().numpy()
    unit = (np.stack(np.meshgrid(*[np.arange(9)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)) / 8
    return bool(view.camera.shows(view.camera.project(low + unit * (high - low))).any())


def _object(view: View) -> tuple[Grey, Mask]:
    """Brightness and mask of the part of the image around the object; all of it where there is no mask."""
    if view.alpha is None:
        mask = np.ones(view.rgb.shape[:2], bool)
    else:
        mask = view.alpha.numpy() > 0.5
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    # An image without the object is looked at whole.
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if len(rows) else ()
    return view.rgb[window].mean(dim=2).numpy().astype(np.float32), np.ascontiguousarray(mask[window])


def _blur(image: Grey, sigma: float) -> Grey:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma))


def _eroded(mask: Mask, pixels: int) -> Mask:
    size = 2 * pixels + 1
    return cv2.erode(mask.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0


def _tiny(view: View) -> np.ndarray:
    rgb = view.rgb if view.alpha is None else view.rgb * view.alpha[..., None]
    return np.asarray(cv2.resize(rgb.numpy(), (_SIDE, _SIDE), interpolation=cv2.INTER_AREA))
