"""The visual hull as a signed distance, to a fraction of a pixel."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from jaxtyping import Float
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from sculpt_framework.errors import DataError
from sculpt_framework.extractors import SdfFunction
from sculpt_framework.types import Camera, View

_FAR = 4.0
"""Distances are cut here, in object units: beyond, only the sign matters."""
_COVERED = 0.5
"""Coverage from which a pixel belongs to the silhouette."""


def visual_hull(views: Sequence[View], max_views: int, device: torch.device) -> SdfFunction:
    """sdf(x) = max over views of (distance of x's image to the silhouette in pixels, negative inside) z / f.

    Exact at the hull's surface up to the masks' sampling, below the true distance outside. A mask that touches the
    border of its image says nothing about what lies beyond that border. At most ``max_views`` views are used, spread
    evenly over the list. A mask that covers no pixel by half carves nothing: the object is thinner there than a pixel,
    or the mask is lost. Cameras and points are in the same frame. Raises DataError where no view has a mask that
    counts.
    """
    masked = [view for view in views if view.alpha is not None]
    if not masked:
        raise DataError("the images have no masks, so there is no visual hull to start from; use --initializer sphere")
    masked = [view for view in masked if view.alpha is not None and bool((view.alpha >= _COVERED).any())]
    if not masked:
        raise DataError("all masks are empty: no pixel of any view is half covered; check the images' alpha channels")
    step = max(1, -(-len(masked) // max_views))
    chosen = [(view.camera, view.alpha) for view in masked[::step] if view.alpha is not None]
    with ThreadPoolExecutor(max_workers=torch.get_num_threads()) as pool:
        carvers = list(pool.map(lambda view: _carver(view[0], view[1], device), chosen))

    @torch.no_grad()
    def hull(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        distance = points.new_full((points.shape[0],), -_FAR)
        for camera, pixels, open_border in carvers:
            distance = torch.maximum(distance, _carve(points, camera, pixels, open_border))
        return distance

    return hull


def signed_mask_distance(alpha: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    """Distance of pixel centres to the outline of alpha = 0.5 in pixels, negative inside.

    Within a pixel of the outline the coverage itself tells where the outline runs.
    """
    coverage = alpha.cpu().numpy()
    inside = coverage >= _COVERED
    if not inside.any():
        return torch.full(coverage.shape, float(sum(coverage.shape)))
    if inside.all():
        return torch.full(coverage.shape, -float(sum(coverage.shape)))
    # Not OpenCV's, many times as fast as it is: it rounds otherwise from call to call.
    outer = np.asarray(ndimage.distance_transform_edt(~inside))
    inner = np.asarray(ndimage.distance_transform_edt(inside))
    distance = np.where(inside, 0.5 - inner, outer - 0.5)
    at_outline = np.abs(distance) <= 0.5
    fractional = (coverage > 0.02) & (coverage < 0.98)
    refined = np.where(at_outline & fractional, 0.5 - coverage, distance)
    return torch.from_numpy(refined.astype(np.float32))


def _carver(
    camera: Camera, alpha: Float[Tensor, "h w"], device: torch.device
) -> tuple[Camera, Float[Tensor, "h w"], bool]:
    edge = torch.cat([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
    return camera.to(device, torch.float32), signed_mask_distance(alpha).to(device), bool((edge >= 0.5).any())


def _carve(
    points: Float[Tensor, "n 3"], camera: Camera, pixels: Float[Tensor, "h w"], open_border: bool
) -> Float[Tensor, " n"]:
    """One view's say on the distance; -_FAR where it says nothing: behind the camera, beyond an open border."""
    pose = camera.world_to_camera
    local = points @ pose[:3, :3].T + pose[:3, 3]
    depth = local[:, 2].clamp(min=1e-6)
    column = camera.fx * local[:, 0] / depth + camera.cx
    row = camera.fy * local[:, 1] / depth + camera.cy
    x, y = column.clamp(0.5, camera.width - 0.5), row.clamp(0.5, camera.height - 0.5)
    normalised = torch.stack([2 * x / camera.width - 1, 2 * y / camera.height - 1], dim=1)
    sampled = functional.grid_sample(
        pixels[None, None], normalised[None, None], mode="bilinear", padding_mode="border", align_corners=False
    )[0, 0, 0]
    beyond = (column - x).abs() + (row - y).abs()
    distance = (sampled + beyond) * depth / max(camera.fx, camera.fy)
    silent = local[:, 2] <= 1e-6
    if open_border:
        silent |= beyond > 0
    return torch.where(silent, -_FAR, distance.clamp(-_FAR, _FAR))
