"""Gaussians bound to the faces of a surface, for measurements, from torch alone."""

import math

import torch
from torch import Tensor

from .splatting import Screen


def bumpy_sphere(count: int, device: torch.device) -> tuple[Tensor, ...]:
    """Means, scales, rotations, opacities and colours of ``count`` flat, nearly opaque Gaussians on a bumpy sphere.

    One per face of a triangulation into faces of about the same solid angle, standard deviation half an edge: what
    ``sculpt-bench raster`` draws, without the triangulation.
    """
    index = torch.arange(count, dtype=torch.float64) + 0.5
    height, angle = 1.0 - 2.0 * index / count, math.pi * (1.0 + 5.0**0.5) * index
    ring = (1.0 - height * height).sqrt()
    directions = torch.stack([ring * angle.cos(), ring * angle.sin(), height], dim=1)
    waves, slopes = (5.0 * directions).sin(), (5.0 * directions).cos()
    radii = 0.8 + 0.06 * waves.prod(dim=1, keepdim=True)
    others = torch.stack([waves[:, 1] * waves[:, 2], waves[:, 0] * waves[:, 2], waves[:, 0] * waves[:, 1]], dim=1)
    gradient = 0.3 * slopes * others
    gradient = gradient - (gradient * directions).sum(dim=1, keepdim=True) * directions
    normals = torch.nn.functional.normalize(radii * directions - gradient, dim=1)
    away = torch.eye(3, dtype=torch.float64)[normals.abs().argmin(dim=1)]
    along = torch.nn.functional.normalize(torch.linalg.cross(normals, away), dim=1)
    frames = torch.stack([normals, along, torch.linalg.cross(normals, along)], dim=2)
    area = 4.0 * math.pi / count * radii**2 / (normals * directions).sum(dim=1, keepdim=True)
    half_edges = 0.5 * (4.0 * area / 3.0**0.5).sqrt()
    colors = torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
    scales = half_edges * torch.tensor([1e-2, 1.0, 1.0], dtype=torch.float64)
    opacities = torch.full((count,), 0.99)
    return tuple(
        value.to(device, torch.float32).contiguous()
        for value in (radii * directions, scales, frames, opacities, colors)
    )


def camera(size: int, device: torch.device) -> tuple[Tensor, Screen]:
    """World-to-camera matrix and image of a camera that sees the sphere fill two fifths of it."""
    pose = torch.eye(4, device=device)
    pose[2, 3] = 2.6
    screen = Screen(
        fx=1.1 * size,
        fy=1.1 * size,
        cx=0.5 * size,
        cy=0.5 * size,
        width=size,
        height=size,
        low_pass_px2=0.3,
        alpha_max=0.999,
        jacobian_margin=0.3,
    )
    return pose, screen


def quaternions(rotations: Tensor) -> Tensor:
    """(n, 4) unit quaternions, real part first, of (n, 3, 3) rotations."""
    r = rotations
    trace = r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2]
    # Four times the squares of w, x, y, z; each column below is the quaternion times four times one of its parts.
    squares = torch.stack([1.0 + trace, *(1.0 - trace + 2.0 * r[:, i, i] for i in range(3))], dim=1)
    wx, wy, wz = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    columns = torch.stack(
        [
            torch.stack([squares[:, 0], wx, wy, wz], dim=1),
            torch.stack([wx, squares[:, 1], xy, xz], dim=1),
            torch.stack([wy, xy, squares[:, 2], yz], dim=1),
            torch.stack([wz, xz, yz, squares[:, 3]], dim=1),
        ],
        dim=1,
    )
    largest = columns[torch.arange(len(r), device=r.device), squares.argmax(dim=1)]
    return torch.nn.functional.normalize(largest, dim=1)
