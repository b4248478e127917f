"""A box in space as cameras see it: its outline and its edges."""

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from sculpt_framework.types import Box, Camera

_NEAR = 0.05
"""Distance from the camera's plane, as a share of half the box's longest side, in front of which edges are cut off."""


def box_outline(camera: Camera, box: Box, share: float = 1.0) -> Bool[np.ndarray, "h w"]:
    """Pixels inside the outline of a box of ``share`` of the size.

    None where the box is behind the camera, all where only a part of it is.
    """
    local = _corners(camera, box, share)
    behind = local[:, 2] <= 1e-6 * np.abs(local).max()
    if behind.any():
        return np.full((camera.height, camera.width), not behind.all())
    inside = np.zeros((camera.height, camera.width), np.uint8)
    # Far outside the image a polygon's corners may not fit the drawing's integers.
    limit = 50 * max(camera.width, camera.height)
    hull = cv2.convexHull(np.round(camera.pixels(local).clip(-limit, limit)).astype(np.int32))
    cv2.fillConvexPoly(inside, hull, (1,))
    return inside.astype(bool)


def box_edges(camera: Camera, box: Box) -> Float64[np.ndarray, "n 2 2"]:
    """Both ends, (column, row), of those of the twelve edges, or of their parts, that are in front of the camera."""
    local, near = _corners(camera, box, 1.0), _NEAR * box.scale
    edges = []
    for first in range(8):
        for second in (first | bit for bit in (1, 2, 4) if not first & bit):
            start, end = local[first], local[second]
            if max(start[2], end[2]) <= near:
                continue
            # Where the edge crosses the plane in front of the camera, both ends are moved there at most.
            along = np.clip((near - start[2]) / (end[2] - start[2]), 0, 1) if start[2] != end[2] else 0.0
            crossing = start + along * (end - start)
            start, end = (crossing if corner[2] < near else corner for corner in (start, end))
            edges.append(camera.pixels(np.stack([start, end])))
    return np.array(edges, np.float64).reshape(-1, 2, 2)


def _corners(camera: Camera, box: Box, share: float) -> Float64[np.ndarray, "8 3"]:
    """In the camera frame; corner n lies on the upper side of those axes whose bits are set in it, x being 4."""
    middle, half = box.center.double().numpy(), 0.5 * (box.maximum - box.minimum).double().numpy()
    low, high = middle - share * half, middle + share * half
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return camera.local(corners)
