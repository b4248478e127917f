"""Gaussians of known shape, and a camera before them."""

import math

import torch
from torch import Tensor

from sculpt_framework.types import Camera, Gaussians

CAMERA = Camera(
    world_to_camera=torch.tensor(
        [[0.8, 0.6, 0, 0], [-0.6, 0.8, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]], dtype=torch.float64
    ),
    fx=40.0, fy=40.0, cx=12.5, cy=9.0, width=26, height=20,
)  # fmt: skip


def ball(opacity: float = 0.9, radius: float = 0.5) -> Gaussians:
    return Gaussians(
        means=torch.zeros(1, 3, dtype=torch.float64),
        scales=torch.full((1, 3), radius, dtype=torch.float64),
        rotations=torch.eye(3, dtype=torch.float64)[None],
        opacities=torch.tensor([opacity], dtype=torch.float64),
        sh=torch.zeros(1, 1, 3, dtype=torch.float64),
        face=torch.full((1,), -1),
    )


def flat(means: Tensor, normals: Tensor, thickness: float, size: float, opacity: float) -> Gaussians:
    other = torch.tensor([0.3, 0.5, -0.8]).to(normals).expand_as(normals)
    first = torch.nn.functional.normalize(torch.linalg.cross(normals, other), dim=1)
    rotations = torch.stack([normals, first, torch.linalg.cross(normals, first)], dim=2)
    count = len(means)
    return Gaussians(
        means=means,
        scales=means.new_tensor([thickness, size, size]).repeat(count, 1),
        rotations=rotations,
        opacities=means.new_full((count,), opacity),
        sh=means.new_zeros(count, 1, 3),
        face=torch.full((count,), -1),
    )


def on_a_sphere(count: int, radius: float = 0.6) -> Gaussians:
    """Evenly spread (Fibonacci), flat, along the surface."""
    number = torch.arange(count, dtype=torch.float64) + 0.5
    height, turn = 1 - 2 * number / count, math.pi * (1 + 5**0.5) * number
    round_ = (1 - height.square()).sqrt()
    normals = torch.stack([round_ * turn.cos(), round_ * turn.sin(), height], dim=1)
    return flat(radius * normals, normals, 0.01, radius * 2.5 / count**0.5, 0.9)
