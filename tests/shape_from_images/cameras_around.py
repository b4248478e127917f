"""Cameras that look at the origin."""

import torch

from sculpt_framework.types import Camera


def camera_from(position: tuple[float, float, float], size: tuple[int, int]) -> Camera:
    """At a place, looking at the origin, its focal length as wide as the image."""
    width, height = size
    back = torch.tensor(position, dtype=torch.float64)
    ahead = -back / back.norm()
    side = torch.linalg.cross(ahead, torch.tensor([0.1, 0.2, 1.0], dtype=torch.float64))
    side = side / side.norm()
    rotation = torch.stack([side, torch.linalg.cross(ahead, side), ahead])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ back
    return Camera(
        fx=float(width), fy=1.1 * width, cx=0.47 * width, cy=0.55 * height, width=width, height=height,
        world_to_camera=pose.float(),
    )  # fmt: skip
