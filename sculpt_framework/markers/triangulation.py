"""Points in space from their pixels in posed photographs, without those pixels that do not fit the others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sculpt_framework.markers.detection import Sighting
from sculpt_framework.types import Camera

_STEPS = 12
_OUTSIDE, _NOISE = 3.5, 0.5
"""A pixel farther off than this many times what is usual is not used; what is usual is no less than so many pixels."""
_PARALLAX = 3.0
"""Degrees between two rays, at least."""
_SIGMA = 1.4826
"""From the median of absolute values to a standard deviation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SpacePoints:
    places: Float64[np.ndarray, "n 3"]
    """World frame; NaN where fewer than two photographs agree on a point."""
    views: Int64[np.ndarray, " n"]
    """That agree on each."""
    seen: int
    """Pixels there are, of all points."""
    used: int
    pixel_error: float
    """Root mean square of the distances in the photographs, in pixels, of those used; NaN without any."""


def triangulate(cameras: Sequence[Camera], sightings: Sequence[Sighting], count: int) -> SpacePoints:
    """``count`` points from what each camera sees of them."""
    poses = np.array([camera.world_to_camera.double().cpu().numpy() for camera in cameras]).reshape(-1, 4, 4)
    lenses = np.array([(camera.fx, camera.fy, camera.cx, camera.cy) for camera in cameras]).reshape(-1, 4)
    owner = np.concatenate([np.full(len(s.points), index) for index, s in enumerate(sightings)]).astype(np.int64)
    names = np.concatenate([s.points for s in sightings])
    pixels = np.concatenate([s.pixels for s in sightings])
    places, views, squares = np.full((count, 3), np.nan), np.zeros(count, np.int64), []
    for name in np.unique(names):
        chosen = names == name
        at = owner[chosen]
        place, kept, errors = _point(poses[at], lenses[at], pixels[chosen])
        if kept.sum() >= 2 and _parallax(poses[at[kept]], place) >= _PARALLAX:
            places[name], views[name] = place, len(np.unique(at[kept]))
            squares.append(errors[kept] ** 2)
    whole = np.concatenate(squares) if squares else np.zeros(0)
    return SpacePoints(
        places=places,
        views=views,
        seen=len(names),
        used=len(whole),
        pixel_error=float(np.sqrt(whole.mean())) if len(whole) else float("nan"),
    )


def _point(
    poses: Float64[np.ndarray, "v 4 4"], lenses: Float64[np.ndarray, "v 4"], pixels: Float64[np.ndarray, "v 2"]
) -> tuple[Float64[np.ndarray, " 3"], Bool[np.ndarray, " v"], Float64[np.ndarray, " v"]]:
    """The place nearest to all rays by their pixels, which of them agree, and how far off each is, in pixels.

    Least squares with weights that fall with the distance (Geman-McClure), then without those that are left outside.
    """
    slopes = (pixels - lenses[:, 2:]) / lenses[:, :2]
    # Two planes a ray: rows of (x - slope z) and (y - slope z) in the camera frame, in pixels at depth 1.
    rows = (poses[:, :2, :] - slopes[:, :, None] * poses[:, 2:3, :]) * lenses[:, :2, None]
    weights, depth, width = np.ones(len(poses)), np.ones(len(poses)), np.inf
    place, errors = np.zeros(3), np.zeros(len(poses))
    for _ in range(_STEPS):
        factor = np.sqrt(weights) / depth
        scaled = rows * factor[:, None, None]
        place = np.linalg.lstsq(scaled[..., :3].reshape(-1, 3), -scaled[..., 3].reshape(-1), rcond=None)[0]
        depth = poses[:, 2, :3] @ place + poses[:, 2, 3]
        depth = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
        errors = np.linalg.norm(rows[..., :3] @ place + rows[..., 3], axis=1) / np.abs(depth)
        width = max(_SIGMA * float(np.median(errors)), _NOISE)
        weights = 1.0 / (1.0 + (errors / (2 * width)) ** 2) ** 2
    kept = (errors < _OUTSIDE * width) & (depth > 0)
    if 2 <= kept.sum() < len(kept):
        scaled = rows[kept] / depth[kept, None, None]
        place = np.linalg.lstsq(scaled[..., :3].reshape(-1, 3), -scaled[..., 3].reshape(-1), rcond=None)[0]
        errors = np.linalg.norm(rows[..., :3] @ place + rows[..., 3], axis=1) / np.abs(depth)
    return place, kept, errors


def _parallax(poses: Float64[np.ndarray, "v 4 4"], place: Float64[np.ndarray, " 3"]) -> float:
    """The largest angle between the first ray and another, in degrees."""
    centers = -np.einsum("vji,vj->vi", poses[:, :3, :3], poses[:, :3, 3])
    ways = place - centers
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip(ways @ ways[0], -1, 1)).max()))
