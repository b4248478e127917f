"""What a run leaves: the mesh with colours and the Gaussians on it, in world frame."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from sculpt_framework.evaluation.extracted import world_mesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.painted import PaintedMesh
from sculpt_framework.geometry.principal_axes import principal_axes
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.sculpting.gaussian_scene import GaussianScene, assemble
from sculpt_framework.types import Box, Gaussians, Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction(PaintedMesh):
    """World frame. ``gaussians`` keep the index of their face in ``faces``; colours are as seen along the normal."""

    gaussians: Gaussians


@torch.no_grad()
def object_gaussians(scene: GaussianScene, surface: Surface) -> Gaussians:
    """The Gaussians of a surface the scene follows, in the object frame."""
    binding = scene.bind(surface, learn=False)
    return assemble(binding, scene.harmonics(binding.means, degree=3, learn=False))


@torch.no_grad()
def reconstruct(scene: GaussianScene, surface: Surface, box: Box) -> Reconstruction:
    """Everything a user gets, from the current surface and the rows that follow it."""
    return in_world(surface, object_gaussians(scene, surface), box)


@torch.no_grad()
def in_world(surface: Surface, gaussians: Gaussians, box: Box) -> Reconstruction:
    """The same for a surface and its Gaussians in the object frame."""
    mesh, kept = world_mesh(surface, box)
    renamed = torch.full((len(kept),), -1, dtype=torch.int64)
    renamed[torch.from_numpy(kept)] = torch.arange(int(kept.sum()))
    face = renamed[gaussians.face.cpu()]
    gaussians = _select(gaussians.to(torch.device("cpu")), face >= 0, face)
    colors = _vertex_colors(mesh, gaussians)
    gaussians = principal_axes(gaussians)
    gaussians = replace(
        gaussians, means=box.to_world(gaussians.means.double()).float(), scales=gaussians.scales * box.scale
    )
    return Reconstruction(vertices=mesh.vertices, faces=mesh.faces, colors=colors, gaussians=gaussians)


def _vertex_colors(mesh: Mesh, gaussians: Gaussians) -> Float[np.ndarray, "v 3"]:
    """Mean colour of the Gaussians on the faces round a vertex, by face area, each seen along its normal."""
    normals = gaussians.rotations[:, :, 0]
    rgb = sh_to_rgb(gaussians.sh, -normals, torch.zeros(3)).clamp(0, 1).double().numpy()
    face = gaussians.face.numpy()
    area = mesh.areas[face] + 1e-30
    sums = np.zeros((len(mesh.vertices), 4))
    for corner in range(3):
        vertex = mesh.faces[face, corner]
        for channel in range(3):
            sums[:, channel] += np.bincount(vertex, area * rgb[:, channel], minlength=len(sums))
        sums[:, 3] += np.bincount(vertex, area, minlength=len(sums))
    return (sums[:, :3] / np.maximum(sums[:, 3:], 1e-300)).astype(np.float32)


def _select(gaussians: Gaussians, chosen: torch.Tensor, face: torch.Tensor) -> Gaussians:
    return Gaussians(
        means=gaussians.means[chosen],
        scales=gaussians.scales[chosen],
        rotations=gaussians.rotations[chosen],
        opacities=gaussians.opacities[chosen],
        sh=gaussians.sh[chosen],
        face=face[chosen],
    )
