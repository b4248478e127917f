"""What bounds an object that silhouettes leave open: the convex hull of what is seen of it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int32
from scipy import ndimage, spatial

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.shape_from_images.volume import Volume, signed_distance
from sculpt_framework.shape_from_images.windows import camera_arrays
from sculpt_framework.types import Camera

with kernel_cache("seeing", Path(__file__).with_name("seeing_kernels.py")):
    from sculpt_framework.shape_from_images import seeing_kernels

_SEEING = 2
"""Views that must see a place for it to count: what one sees alone may be at any depth."""
_WALL = 2
"""Outermost cells on each side in which a shape that silhouettes bound has nothing."""
_FIRST = np.float32(3)
"""Cells from the surface on in which it does not hide itself, as at a grazing angle its own steps would."""


def reaches_walls(solid: Volume) -> bool:
    """Whether the shape is cut off by the edge of the volume: no silhouette bounds it there."""
    within = np.zeros(solid.shape, bool)
    within[_WALL:-_WALL, _WALL:-_WALL, _WALL:-_WALL] = True
    return bool((solid.values < 0)[~within].any())


def enclosed(solid: Volume, cameras: Sequence[Camera]) -> Volume:
    """The part of the shape that lies in the convex hull of what at least two cameras see of its surface.

    ``solid`` is a signed distance, negative inside, in the frame of the cameras. A camera sees a place that lies in its
    image and that nothing of the shape hides. Behind an object photographed from one side the shape would go on to the
    end of the volume, as no silhouette says where it ends; so it is closed by planes from edge to edge. Returns
    ``solid`` itself if nothing is seen.
    """
    inside = solid.values < 0
    surface = inside & ~np.asarray(ndimage.binary_erosion(inside), dtype=bool)
    points = solid.points[surface.reshape(-1)]
    seen = points[_views_seeing(points, solid, cameras) >= _SEEING]
    if not len(seen):
        return solid
    # A cell further out on all sides: the surface lies beyond the centres of its cells, and a plane has a volume.
    steps = solid.cell * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    corners = (seen.astype(np.float64)[:, None] + steps).reshape(-1, 3)
    planes = np.unique(spatial.ConvexHull(corners).equations.round(5), axis=0).astype(np.float32)
    values = solid.values.reshape(-1).copy()
    share_threads()
    seeing_kernels.cut_by_planes(solid.points, planes, values)
    values = values.reshape(solid.shape)
    return solid.holding(signed_distance(values < 0, values, solid.cell))


def _views_seeing(
    points: Float32[np.ndarray, "n 3"], solid: Volume, cameras: Sequence[Camera]
) -> Int32[np.ndarray, " n"]:
    share_threads()
    counts = np.zeros(len(points), np.int32)
    poses, lenses, positions = camera_arrays(cameras)
    sizes = np.array([[camera.height, camera.width] for camera in cameras], np.int64)
    seeing_kernels.count_seeing(
        points, poses, lenses, sizes, positions, solid.values < 0, np.array(solid.origin, np.float32),
        np.float32(solid.cell), _FIRST, counts,
    )  # fmt: skip
    return counts
