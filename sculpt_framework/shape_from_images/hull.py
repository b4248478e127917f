"""The visual hull as a signed distance, to a fraction of a pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.errors import DataError
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.shape_from_images.windows import covered_window, touches_border
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Camera, View

with kernel_cache("hull", Path(__file__).with_name("hull_kernels.py")):
    from sculpt_framework.shape_from_images import hull_kernels

_FAR, _DEEP = 0.5, 4.0
"""Distances outside and inside are cut here, in object units: beyond, only the sign matters."""
_MARGIN = 4
"""Pixels kept around a silhouette."""
_COVERED = 0.5
"""Coverage from which a pixel belongs to the silhouette."""


def visual_hull(views: Sequence[View], max_views: int) -> SdfFunction:
    """sdf(x) = max over views of (distance of x's image to the silhouette in pixels, negative inside) z / f.

    Exact at the hull's surface up to the masks' sampling, below the true distance outside. A mask that touches the
    border of its image says nothing about what lies beyond that border; where all masks do, what no image shows is
    outside. At most ``max_views`` views are used, spread evenly over the list. A mask that covers no pixel by half
    carves nothing: the object is thinner there than a pixel, or the mask is lost. Cameras and points are in the same
    frame. Raises DataError where no view has a mask that counts.
    """
    masked = [view for view in views if view.alpha is not None]
    if not masked:
        raise DataError("the images have no masks, so there is no visual hull to start from; use --initializer sphere")
    masked = [view for view in masked if view.alpha is not None and bool((view.alpha >= _COVERED).any())]
    if not masked:
        raise DataError("all masks are empty: no pixel of any view is half covered; check the images' alpha channels")
    step = max(1, -(-len(masked) // max_views))
    outlines = _outlines([(view.camera, view.alpha) for view in masked[::step] if view.alpha is not None])

    def hull(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        return torch.from_numpy(_largest(outlines, points.detach().cpu().float().numpy())).to(points)

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
    # Not OpenCV's: it rounds otherwise from call to call. Nor SciPy's, which takes ten times as long.
    outer, inner = np.empty(inside.shape), np.empty(inside.shape)
    hull_kernels.squared_distances(inside, outer)
    hull_kernels.squared_distances(~inside, inner)
    distance = np.where(inside, 0.5 - np.sqrt(inner), np.sqrt(outer) - 0.5)
    at_outline = np.abs(distance) <= 0.5
    fractional = (coverage > 0.02) & (coverage < 0.98)
    refined = np.where(at_outline & fractional, 0.5 - coverage, distance)
    return torch.from_numpy(refined.astype(np.float32))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Outlines:
    """Cameras and signed distances to silhouettes as plain arrays: see ``hull_kernels.carve``."""

    pixels: Float32[np.ndarray, " p"]
    starts: Int64[np.ndarray, " v"]
    lenses: Float32[np.ndarray, "v 12"]
    """Rows of the matrices that lead to pixels, counted from the middle of the first."""
    per_depth: Float32[np.ndarray, " v"]
    sizes: Int64[np.ndarray, "v 2"]
    is_open: Bool[np.ndarray, " v"]


def _outlines(views: Sequence[tuple[Camera, Float[Tensor, "_ _"]]]) -> _Outlines:
    views = [_cropped(camera, alpha) for camera, alpha in views]
    distances = in_threads(lambda view: signed_mask_distance(view[1]).numpy(), views)
    # A row and a column more: every pixel has neighbours to interpolate with.
    padded = [np.pad(distance, ((0, 1), (0, 1)), mode="edge").reshape(-1) for distance in distances]
    counts = np.array([len(pixels) for pixels in padded], np.int64)
    lenses = [_to_pixels(camera) @ camera.world_to_camera[:3].double().cpu().numpy() for camera, _ in views]
    return _Outlines(
        pixels=np.concatenate(padded),
        starts=np.cumsum(counts) - counts,
        lenses=np.stack(lenses).reshape(-1, 12).astype(np.float32),
        per_depth=np.array([1 / max(camera.fx, camera.fy) for camera, _ in views], np.float32),
        sizes=np.array([distance.shape for distance in distances], np.int64),
        is_open=np.array([touches_border(alpha >= _COVERED) for _, alpha in views]),
    )


def _to_pixels(camera: Camera) -> Float64[np.ndarray, "3 3"]:
    return np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])


def _cropped(camera: Camera, alpha: Float[Tensor, "h w"]) -> tuple[Camera, Float[Tensor, "h2 w2"]]:
    """Without most of what is outside, unless the silhouette goes on beyond the image."""
    if touches_border(alpha >= _COVERED):
        return camera, alpha
    x, y, width, height = covered_window(alpha, _MARGIN)
    return camera.crop(x, y, width, height), alpha[y : y + height, x : x + width]


def _largest(outlines: _Outlines, points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
    """What the views together say of points in the object frame."""
    share_threads()
    distances = np.empty(len(points), np.float32)
    hull_kernels.carve(
        np.ascontiguousarray(points.T), outlines.pixels, outlines.starts, outlines.lenses, outlines.per_depth,
        outlines.sizes, outlines.is_open, np.float32(-_DEEP), np.float32(_FAR), distances,
    )  # fmt: skip
    return distances
