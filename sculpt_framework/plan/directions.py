"""How much the colours of places on the object change with the direction they are seen from.

Places are points of a coarse visual hull, their colours those of reduced images. Where the hull is not the surface, or
texture is finer than a reduced pixel, views disagree too, but as often by darker colours as by brighter ones, while a
highlight adds to all three channels. So what counts is by how much more a place brightens than it darkens.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.volume import Volume, sample
from sculpt_framework.spread import spread
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, Camera, View

_CPU = torch.device("cpu")
_CELLS = 40
"""Along each axis of the object's box, of the volume that holds the hull."""
_HULL_VIEWS = 40
_COLOR_VIEWS = 60
_PIXELS = 64
"""Along the longer side of the reduced images."""
_HULL_PIXELS = 96
_POINTS = 1200
_MANY = 8
"""Views that must see a point for a tenth of them to say what a highlight is."""
_LEAST = 4
"""Views that must see a point for it to tell how much they differ."""
_LEAST_POINTS = 50
_FACING = 0.35
"""Cosine of the steepest angle under which a point is looked at."""
_STEPS = 12
"""Places on the way to a camera where the hull may be in between."""
_TAIL = 0.9
"""Quantile over a point's views: a highlight is seen by few of them."""
_AMONG_POINTS = 0.75
"""Quantile over the points: no highlight is everywhere."""
_ON_SURFACE = 0.1
"""Quantile over the points: where the hull is not the surface, or textured, views disagree whatever the light."""
_BURNT_OUT = 0.98
"""Brightness of the darkest channel from which on it says only that there was much light."""


@dataclass(frozen=True, kw_only=True)
class Gloss:
    strength: float | None
    """How much brighter than usual, in [0, 1], a place gets in a tenth of the views that see it, less how much darker
    it gets in a tenth; of the place at three quarters of them all. None where too few places are seen by eight views.
    """
    points: int
    """Places that were looked at."""
    unevenness: float
    """By what share of its brightness a place usually differs between views, of a place among the tenth that differ
    least: how much the light, the exposure or the camera's noise changes from image to image. Where all channels are
    clipped nothing can differ: that does not count."""


def gloss(views: Sequence[View], box: Box) -> Gloss | None:
    """None where it cannot be told: too few masks, or too few points seen by enough views."""
    masked = [view for view in views if view.alpha is not None and view.shows_object]
    if len(masked) < _LEAST:
        return None
    posed = [replace(view, camera=box.camera_to_object(view.camera)) for view in masked]
    small = in_threads(partial(_reduced, pixels=_HULL_PIXELS), spread(posed, _HULL_VIEWS))
    pictures = in_threads(partial(_reduced, pixels=_PIXELS), spread(posed, _COLOR_VIEWS))
    hull = sample(visual_hull(small, _HULL_VIEWS), (1.0, 1.0, 1.0), _CELLS, _CPU)
    points, normals = _surface_points(hull)
    seen, colors = [], []
    for picture in pictures:
        color, whole = _look_up(picture, points)
        place = picture.camera.position.float()
        facing = (functional.normalize(place - points, dim=1) * normals).sum(dim=1) > _FACING
        seen.append(facing & whole & _free(hull, points, normals, place))
        colors.append(color)
    return brightening(torch.stack(seen, 1), torch.stack(colors, 1))


def brightening(seen: Bool[Tensor, "n v"], colors: Float[Tensor, "n v 3"]) -> Gloss | None:
    """Of n places in v views: ``gloss`` from colours alone. None where too few places are seen by four
    views, and not over-exposed.

    Places that eight views see count alone where there are enough.
    """
    often = seen.sum(dim=1) >= _MANY
    told = int(often.sum()) >= _LEAST_POINTS
    enough = often if told else seen.sum(dim=1) >= _LEAST
    if int(enough.sum()) < _LEAST_POINTS:
        return None
    seen, colors = seen[enough], colors[enough]
    usual = torch.where(seen[..., None], colors, torch.nan).nanmedian(dim=1, keepdim=True).values
    change = colors - usual
    tails = []
    for sign in (1.0, -1.0):
        # The least of the channels: what all of them have in common.
        common = torch.where(seen, (sign * change).amin(dim=2).clamp(min=0), torch.nan)
        tails.append(common.nanquantile(_TAIL, dim=1))
    uneven = _unevenness(seen & (colors.amin(dim=2) < _BURNT_OUT), colors)
    if uneven is None:
        return None
    strength = float((tails[0] - tails[1]).quantile(_AMONG_POINTS)) if told else None
    return Gloss(strength=strength, points=len(seen), unevenness=uneven)


def _unevenness(seen: Bool[Tensor, "n v"], colors: Float[Tensor, "n v 3"]) -> float | None:
    enough = seen.sum(dim=1) >= _LEAST
    if int(enough.sum()) < _LEAST_POINTS:
        return None
    seen, colors = seen[enough], colors[enough]
    usual = torch.where(seen[..., None], colors, torch.nan).nanmedian(dim=1, keepdim=True).values
    away = torch.where(seen, (colors - usual).abs().mean(dim=2), torch.nan).nanmedian(dim=1).values
    return float(away.quantile(_ON_SURFACE)) / max(float(usual.mean(dim=2).nanmedian()), 1e-3)


def _reduced(view: View, pixels: int) -> View:
    camera = view.camera
    factor = min(1.0, pixels / max(camera.width, camera.height))
    width, height = max(2, round(camera.width * factor)), max(2, round(camera.height * factor))
    alpha = view.alpha
    assert alpha is not None, "only views with masks get here"  # noqa: S101
    both = torch.cat([view.rgb * alpha[..., None], alpha[..., None]], dim=2).float().numpy()
    small = torch.from_numpy(np.asarray(cv2.resize(both, (width, height), interpolation=cv2.INTER_AREA)))
    rgb = small[..., :3] / small[..., 3:].clamp(min=1e-3)
    camera = camera.resized(width, height).to(torch.device("cpu"), torch.float32)
    return View(name=view.name, camera=camera, rgb=rgb, alpha=small[..., 3])


def _surface_points(hull: Volume) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """Points on the hull, spread over it, and outward normals."""
    value, cell = hull.interpolator(_CPU), hull.cell
    near = torch.from_numpy(hull.points[np.abs(hull.values.reshape(-1)) < cell])
    points = near[torch.randperm(len(near), generator=torch.Generator().manual_seed(0))[:_POINTS]]
    normals = _gradient(value, points, cell)
    for _ in range(3):
        points = points - value(points)[:, None].clamp(-cell, cell) * normals
        normals = _gradient(value, points, cell)
    good = (value(points).abs() < 0.2 * cell) & (normals.norm(dim=1) > 0.5)
    return points[good], normals[good]


def _gradient(value: SdfFunction, points: Float[Tensor, "n 3"], step: float) -> Float[Tensor, "n 3"]:
    offsets = step * torch.eye(3)
    slopes = [value(points + offset) - value(points - offset) for offset in offsets]
    return functional.normalize(torch.stack(slopes, dim=1), dim=1)


def _free(
    hull: Volume, points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], camera: Float[Tensor, " 3"]
) -> Bool[Tensor, " n"]:
    """Whether nothing of the hull is between the points and the camera."""
    value, start = hull.interpolator(_CPU), points + 1.5 * hull.cell * normals
    way = functional.normalize(camera - start, dim=1)
    free = torch.ones(len(points), dtype=torch.bool)
    for step in torch.linspace(0.0, 2.0, _STEPS).tolist():
        at = start + step * way
        outside = at.abs().amax(dim=1) > -hull.origin[0]
        free &= outside | (value(at) > 0)
    return free


def _look_up(view: View, points: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n 3"], Bool[Tensor, " n"]]:
    """Colours where the points are seen, and whether all pixels around are the object's."""
    camera: Camera = view.camera
    pixels = camera.project(points.double().numpy())
    # What is not in front of the camera is NaN, and looked up outside the image, where all is 0.
    outside = np.isnan(pixels[:, :1])
    across = np.where(outside, -3, 2 * pixels / (camera.width, camera.height) - 1)
    where = torch.from_numpy(across).to(points)[None, None]
    assert view.alpha is not None  # noqa: S101
    image = torch.cat([view.rgb, view.alpha[..., None]], dim=2).permute(2, 0, 1)[None]
    found = functional.grid_sample(image, where, padding_mode="zeros", align_corners=False)[0, :, 0].T
    return found[:, :3], found[:, 3] > 0.98
