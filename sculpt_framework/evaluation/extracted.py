"""An extracted surface as the mesh a user gets."""

import numpy as np
import torch

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.geometry.coincident import separate
from sculpt_framework.geometry.stray import compact, main_faces
from sculpt_framework.types import Box, Surface


@torch.no_grad()
def world_mesh(surface: Surface, box: Box) -> tuple[Mesh, np.ndarray]:
    """The surface without stray pieces, in world frame, and which of its faces were kept.

    No two vertices are at the same place, as 32-bit floats either, so that what reads the file finds it closed.
    """
    vertices, faces = surface.vertices.double().cpu().numpy(), surface.faces.cpu().numpy()
    kept = main_faces(vertices, faces)
    points, faces, _ = compact(vertices, faces[kept])
    world = points * box.scale + box.center.double().numpy()
    return Mesh(vertices=separate(world, faces), faces=faces), kept
