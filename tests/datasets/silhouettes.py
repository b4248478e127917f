"""Views of balls that are known exactly."""

from collections.abc import Sequence

import numpy as np
import torch

from sculpt_framework.types import Camera, View


def ball_views(centers: Sequence[Sequence[float]], radii: Sequence[float], cameras: Sequence[Camera]) -> list[View]:
    """Exact silhouettes of balls."""
    views = []
    for camera in cameras:
        pose = camera.world_to_camera.numpy()
        rows, columns = np.indices((camera.height, camera.width)) + 0.5
        rays = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)])
        rays /= np.linalg.norm(rays, axis=0)
        mask = np.zeros(rows.shape, bool)
        for center, radius in zip(centers, radii, strict=True):
            local = pose[:3, :3] @ np.array(center) + pose[:3, 3]
            along = np.einsum("c,chw->hw", local, rays)
            mask |= (local @ local - along**2 < radius**2) & (along > 0)
        alpha = torch.from_numpy(mask.astype(np.float32))
        views.append(View(name="v", camera=camera, rgb=torch.zeros(*alpha.shape, 3), alpha=alpha))
    return views
