"""The part of an image that shows the object, and how views stand to each other."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from sculpt_framework.types import Camera


def covered_window(alpha: Float[Tensor, "h w"], margin: int) -> tuple[int, int, int, int]:
    """Column, row, width and height of the part of an image that holds all pixels covered by half, of which there is
    one, and ``margin`` pixels around as far as there are."""
    covered = alpha >= 0.5
    spans = []
    for axis, count in ((0, alpha.shape[1]), (1, alpha.shape[0])):
        places = covered.any(dim=axis).nonzero()[:, 0]
        first = max(0, int(places[0]) - margin)
        spans.append((first, min(count, int(places[-1]) + 1 + margin) - first))
    (x, width), (y, height) = spans
    return x, y, width, height


def touches_border(mask: Bool[np.ndarray | Tensor, "h w"]) -> bool:
    """Whether any pixel of the mask lies at the border of the image: what it shows may go on beyond."""
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())


def camera_arrays(
    cameras: Sequence[Camera],
) -> tuple[Float32[np.ndarray, "v 3 4"], Float32[np.ndarray, "v 4"], Float32[np.ndarray, "v 3"]]:
    """World-to-camera matrices, (fx, fy, cx, cy) and positions, as kernels take them."""
    poses = [camera.world_to_camera[:3].double().cpu().numpy() for camera in cameras]
    lenses = [[camera.fx, camera.fy, camera.cx, camera.cy] for camera in cameras]
    positions = [camera.position.double().cpu().numpy() for camera in cameras]
    return (
        np.array(poses, np.float32).reshape(-1, 3, 4),
        np.array(lenses, np.float32).reshape(-1, 4),
        np.array(positions, np.float32).reshape(-1, 3),
    )


def relative_poses(
    poses: Float32[np.ndarray, "v 3 4"], view: int, others: Int64[np.ndarray, " n"]
) -> Float32[np.ndarray, "n 3 4"]:
    """What leads from the camera frame of a view into those of others."""
    rotation, translation = poses[view, :, :3].astype(float), poses[view, :, 3].astype(float)
    turned = poses[others, :, :3].astype(float) @ rotation.T
    return np.concatenate([turned, poses[others, :, 3:] - (turned @ translation)[..., None]], 2).astype("f4")
