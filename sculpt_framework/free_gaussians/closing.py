"""An open mesh made closed: the half level of its winding number, on a grid."""

import igl
import numpy as np
import torch
from scipy.spatial import KDTree

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.geometry import topology
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.shape_from_images.tsdf import surface_of
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.types import Surface

_FAR = 2.0
"""Cells from the mesh beyond which it does not matter how far it is."""


def is_closed(mesh: Mesh) -> bool:
    """Closed, manifold along its edges, oriented, and outward."""
    faces = mesh.faces
    if len(faces) == 0 or len(topology.boundary_edges(faces)) or not topology.is_edge_manifold(faces):
        return False
    return topology.is_consistently_oriented(faces) and topology.signed_volume(mesh.vertices, faces) > 0


def closed_surface(mesh: Mesh, grid: Grid, extractor: ExtractorConfig, device: torch.device) -> Surface:
    """What the mesh, in the frame of the grid and outward, encloses by its winding number (Jacobson et al. 2013).

    By the mesh the level is the distance to it; across a hole it is where the winding number is a half. Raises
    EmptySurfaceError where it encloses nothing.
    """
    axes = [torch.arange(count + 1) for count in grid.shape]
    corners = grid.corner_positions(torch.cartesian_prod(*axes), torch.float64).numpy()
    winding = np.asarray(igl.fast_winding_number(mesh.vertices, mesh.faces, corners))
    distance = np.full(len(corners), _FAR * grid.cell)
    # No point of a face is farther from its middle than its longest side.
    middles, sides = mesh.corners.mean(axis=1), np.roll(mesh.corners, 1, axis=1) - mesh.corners
    reach = _FAR * grid.cell + float(np.linalg.norm(sides, axis=2).max())
    close = np.isfinite(KDTree(middles).query(corners, distance_upper_bound=reach)[0])
    squared = np.asarray(igl.point_mesh_squared_distance(corners[close], mesh.vertices, mesh.faces)[0])
    distance[close] = np.minimum(distance[close], np.sqrt(squared))
    # Far from the mesh, as in the middle of a hole, the winding number itself says where the level is.
    values = 2 * (0.5 - winding) * distance
    x, y, z = (start - 0.5 * grid.cell for start in grid.origin)
    shape = tuple(len(axis) for axis in axes)
    volume = Volume(values=values.reshape(shape).astype(np.float32), origin=(x, y, z), cell=grid.cell)
    level, seeds = surface_of(volume, grid, device)
    return extractor.build(grid, device).extract(level, seeds).surface
