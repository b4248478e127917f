"""Normals of a depth map, and the rays through its pixels."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sculpt_framework.types import Camera


def rays_through(camera: Camera, columns: Float[Tensor, "*n"], rows: Float[Tensor, "*n"]) -> Float[Tensor, "*n 3"]:
    """Rays of places in pixels, with z = 1, in camera coordinates."""
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    return torch.stack([x, y, torch.ones_like(x)], dim=-1)


def pixel_rays(camera: Camera, like: Float[Tensor, "..."]) -> Float[Tensor, "h w 3"]:
    """Rays through the centres of all pixels, with z = 1, in camera coordinates; device and type as ``like``."""
    rows, columns = torch.meshgrid(
        torch.arange(camera.height, device=like.device, dtype=like.dtype) + 0.5,
        torch.arange(camera.width, device=like.device, dtype=like.dtype) + 0.5,
        indexing="ij",
    )
    return rays_through(camera, columns, rows)


def normals_of_depths(
    depth: Float[Tensor, "h w"], covered: Bool[Tensor, "h w"], camera: Camera
) -> tuple[Float[Tensor, "h2 w2 3"], Bool[Tensor, "h2 w2"]]:
    """Unit normals in camera coordinates, towards the camera, by central differences, of all but the border's pixels;
    and where they count: where all four neighbours are covered and in front of the camera.

    A surface that is seen edge on has no normal here: 0, without gradient, and does not count.
    """
    points = pixel_rays(camera, depth) * depth[..., None]
    right, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    crossed = torch.linalg.cross(down, right)
    squared = crossed.square().sum(dim=2, keepdim=True)
    known = covered & (depth > 0)
    counts = known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1] & (squared[..., 0] > 0)
    return crossed * torch.where(squared > 0, squared, 1.0).rsqrt(), counts
