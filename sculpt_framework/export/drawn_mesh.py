"""Meshes in colours as cameras see them: how a method looks that renders nothing itself."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.mesh_files import read_colored_mesh
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.types import Camera, Rendering

GREY = 0.7
"""Of a mesh that has no colours."""


def draw_mesh_in_colors(mesh: Mesh, colors: Float[np.ndarray, "v 3"], camera: Camera) -> Rendering:
    """On white; mesh and camera in the same frame, ``colors`` of the vertices sRGB in [0, 1]."""
    drawn = draw_mesh(mesh.vertices, mesh.faces, camera)
    seen = drawn.face >= 0
    rgb = np.where(seen[..., None], drawn.interpolate(mesh.faces, colors.astype(np.float32)), np.float32(1))
    return Rendering(
        rgb=torch.from_numpy(rgb),
        alpha=torch.from_numpy(seen.astype(np.float32)),
        depth=torch.from_numpy(np.where(seen, drawn.depth, np.float32(0))),
    )


def draw_saved_mesh(path: Path) -> Callable[[Camera], Rendering]:
    """How a mesh file in world frame looks from cameras. Raises DataError if there is none."""
    vertices, faces, colors = read_colored_mesh(path)
    mesh = Mesh(vertices=vertices.astype(np.float64), faces=faces)
    painted = np.full(vertices.shape, GREY, np.float32) if colors is None else colors
    return lambda camera: draw_mesh_in_colors(mesh, painted, camera)
