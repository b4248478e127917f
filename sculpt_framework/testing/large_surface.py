"""A surface of any size, to try what has to bear large ones."""

import math

import torch

from sculpt_framework.geometry.grid import Grid, pack
from sculpt_framework.snapshot import Cells, Snapshot
from sculpt_framework.types import Box, Gaussians, Surface


def large_snapshot(faces: int, gaussians_per_face: int) -> Snapshot:
    """A closed, bumpy ball of about so many faces, with coloured Gaussians on them and one cell for every four."""
    rings = round(math.sqrt(faces / 4))
    theta = torch.linspace(0, math.pi, rings + 1)[1:-1, None]
    phi = torch.linspace(0, 2 * math.pi, 2 * rings + 1)[None, :-1]
    radius = 0.8 + 0.1 * torch.sin(5 * theta) * torch.cos(7 * phi)
    around = radius[..., None] * torch.stack(
        torch.broadcast_tensors(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()), dim=-1
    )
    vertices = torch.cat([around.reshape(-1, 3), torch.tensor([[0.0, 0.0, 0.8], [0.0, 0.0, -0.8]])])
    index = torch.arange((rings - 1) * 2 * rings).reshape(rings - 1, 2 * rings)
    a, b, c, d = index[:-1], index[:-1].roll(-1, 1), index[1:], index[1:].roll(-1, 1)
    top, bottom = torch.full_like(index[0], len(vertices) - 2), torch.full_like(index[0], len(vertices) - 1)
    quads = [torch.stack([a, c, d], -1), torch.stack([a, d, b], -1)]
    caps = [
        torch.stack([top, index[0], index[0].roll(-1)], -1),
        torch.stack([bottom, index[-1].roll(-1), index[-1]], -1),
    ]
    triangles = torch.cat([each.reshape(-1, 3) for each in (*quads, *caps)])
    surface = Surface(vertices=vertices, faces=triangles, face_keys=torch.arange(len(triangles)))
    level = max(0, math.ceil(math.log2(rings)) - 3)
    grid = Grid(origin=(-1.0, -1.0, -1.0), base_shape=(8, 8, 8), base_cell=0.25, level=level)
    centers = vertices[triangles].mean(dim=1)
    cells = pack(level, ((centers[::4] + 1) / (0.25 / 2**level)).long()).unique()
    return Snapshot(
        surface=surface,
        gaussians=_gaussians(surface, gaussians_per_face),
        box=Box(minimum=-torch.ones(3), maximum=torch.ones(3)),
        cells=Cells(grid=grid, keys=cells),
    )


def _gaussians(surface: Surface, per_face: int) -> Gaussians:
    corners = surface.vertices[surface.faces].repeat_interleave(per_face, dim=0)
    generator = torch.Generator().manual_seed(0)
    weights = torch.rand(len(corners), 3, generator=generator).add(0.2)
    means = (corners * (weights / weights.sum(dim=1, keepdim=True))[..., None]).sum(dim=1)
    edge = corners[:, 1] - corners[:, 0]
    tangent = edge / edge.norm(dim=1, keepdim=True).clamp_min(1e-12)
    normal = torch.linalg.cross(edge, corners[:, 2] - corners[:, 0])
    normal = normal / normal.norm(dim=1, keepdim=True).clamp_min(1e-20)
    size = 0.35 * edge.norm(dim=1, keepdim=True)
    return Gaussians(
        means=means,
        scales=torch.cat([0.05 * size, size, size], dim=1),
        rotations=torch.stack([normal, tangent, torch.linalg.cross(normal, tangent)], dim=2),
        opacities=torch.full((len(means),), 0.99),
        sh=torch.sin(8 * means)[:, None],
        face=torch.arange(len(surface.faces)).repeat_interleave(per_face),
    )
