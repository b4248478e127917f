"""Training images of a stage: cropped to the object, scaled, in the object frame."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.losses import TrainingImage
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, Camera, View

_MARGIN_SHARE = 0.06
"""Border kept around the object's box in an image, as a share of the box's longer side: room for the surface to be
wrong in and still be seen."""
_MARGIN_PIXELS = 6


def prepare_image(
    view: View, box: Box, scale: float, device: torch.device, *, crop: bool = True, around: float | None = None
) -> TrainingImage:
    """One view of a stage. ``scale`` is the image side relative to the input, at most 1.

    Where what is ``around`` the object is looked at, too, the image has a border of that share of the object's longer
    side, if the photograph reaches so far.
    """
    camera = box.camera_to_object(view.camera)
    rgb, alpha = view.rgb, view.alpha
    if crop:
        x0, y0, x1, y1 = object_window(view, camera, box, around or 0.0)
        camera = camera.crop(x0, y0, x1 - x0, y1 - y0)
        rgb = rgb[y0:y1, x0:x1]
        alpha = None if alpha is None else alpha[y0:y1, x0:x1]
    photograph = None if around is None else rgb
    if alpha is not None:
        rgb = rgb * alpha[..., None]
    if scale < 1.0:
        width, height = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
        camera = camera.resized(width, height)
        rgb = _shrink(rgb, width, height)
        alpha = None if alpha is None else _shrink(alpha, width, height)
        photograph = None if photograph is None else _shrink(photograph, width, height)
    return TrainingImage(
        name=view.name,
        camera=camera.to(device, torch.float32),
        premultiplied=rgb.to(device, torch.float32).contiguous(),
        alpha=None if alpha is None else alpha.to(device, torch.float32).contiguous(),
        photograph=None if photograph is None else photograph.to(device, torch.float32).contiguous(),
    )


def prepare_images(
    views: Sequence[View], box: Box, scale: float, device: torch.device, *, around: float | None = None
) -> list[TrainingImage]:
    """All views of a stage, as many at a time as there are threads."""
    return in_threads(lambda view: prepare_image(view, box, scale, device, around=around), views)


def in_object_frame(view: View, box: Box) -> View:
    """The same view with its camera in the object frame."""
    return replace(view, camera=box.camera_to_object(view.camera))


def pixel_footprint(images: Sequence[TrainingImage]) -> float:
    """Side of a pixel at the object's centre in object units, median over the views."""
    sides = [float(image.camera.world_to_camera[:3, 3].norm()) / image.camera.fx for image in images]
    return float(np.median(sides))


def _shrink(image: Float[Tensor, "h w *c"], width: int, height: int) -> Float[Tensor, "h2 w2 *c"]:
    """Mean over the area of each new pixel."""
    return torch.from_numpy(cv2.resize(image.numpy(), (width, height), interpolation=cv2.INTER_AREA))


def object_window(view: View, camera: Camera, box: Box, around: float = 0.0) -> tuple[int, int, int, int]:
    """Columns and rows [x0, x1) x [y0, y1) that hold the object, with a margin, which is at least a share ``around`` of
    the object's longer side; the whole image if nothing is known."""
    low, high = np.zeros(2), np.array([camera.width, camera.height], dtype=float)
    if view.alpha is not None:
        covered = view.alpha.numpy() > 0.0
        columns, rows = np.flatnonzero(covered.any(axis=0)), np.flatnonzero(covered.any(axis=1))
        if len(rows) == 0:
            return 0, 0, camera.width, camera.height
        first = np.array([columns[0], rows[0]], dtype=float)
        last = np.array([columns[-1] + 1, rows[-1] + 1], dtype=float)
    else:
        signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        local = camera.local(signs * box.half_sides.double().numpy())
        if (local[:, 2] <= 1e-3).any():
            return 0, 0, camera.width, camera.height
        pixels = camera.pixels(local)
        first, last = pixels.min(axis=0), pixels.max(axis=0)
    margin = max(_MARGIN_PIXELS, max(_MARGIN_SHARE, around) * float((last - first).max()))
    x0, y0 = np.floor(np.maximum(first - margin, low)).astype(int)
    x1, y1 = np.ceil(np.minimum(last + margin, high)).astype(int)
    if x1 - x0 < 1 or y1 - y0 < 1:
        return 0, 0, camera.width, camera.height
    return int(x0), int(y0), int(x1), int(y1)
