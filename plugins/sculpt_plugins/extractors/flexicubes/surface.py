"""The dual surface of a band, on a grid or an octree: differentiable positions, triangles, and what losses look at."""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import Band, levels_of
from sculpt_framework.geometry.grid import PART_BITS
from sculpt_framework.geometry.octree import AXES, CORNER_POINTS, EDGE_ENDS
from sculpt_framework.geometry.octree_band import OctreeBand
from sculpt_framework.types import Surface
from sculpt_plugins.extractors.flexicubes.geometry import dual_vertices
from sculpt_plugins.extractors.flexicubes.octree_cycles import SLOTS, slot_of
from sculpt_plugins.extractors.flexicubes.octree_topology import OctreeTopology, octree_topology
from sculpt_plugins.extractors.flexicubes.topology import dual_topology
from sculpt_plugins.extractors.flexicubes.triangles import DESCENDING_PART, TRIANGLE_PRIMITIVE, split_quads

Split = Literal["diagonal", "center"]


@dataclass(frozen=True, kw_only=True, eq=False)
class DualSurface:
    surface: Surface
    edge_sdf: Float[Tensor, "e 2"]
    """Signed distance at the inner and the outer end of every crossed edge; on an octree, of every minimal one."""
    deviation: Float[Tensor, " d"]
    """Of every dual vertex, the mean absolute deviation of its distances to its crossings."""


def grid_surface(
    band: Band,
    cell: float,
    split: Split,
    alpha: Float[Tensor, "c 8"] | None = None,
    beta: Float[Tensor, "c 12"] | None = None,
    gamma: Float[Tensor, "c 1"] | None = None,
    *,
    damp_grazing: bool = False,
) -> DualSurface:
    """The closed surface of a band with cells of side ``cell``.

    The weights, of its cells, are positive and 1 where they are not given. ``damp_grazing`` as in ``dual_vertices``.
    """
    topology = dual_topology(band)
    vertices, deviation = dual_vertices(
        topology,
        band.corner_positions,
        band.corner_sdf,
        cell,
        alpha=alpha,
        beta=beta,
        damp_grazing=damp_grazing,
    )
    keys = topology.keys + DESCENDING_PART * topology.descending
    return DualSurface(
        surface=split_quads(vertices, topology.vertices, topology.cells, topology.axis, keys, gamma, split),
        edge_sdf=band.corner_sdf.index_select(0, topology.ends.reshape(-1)).reshape(-1, 2),
        deviation=deviation,
    )


def octree_surface(
    band: OctreeBand,
    split: Split,
    alpha: Float[Tensor, "c 8"] | None = None,
    beta: Float[Tensor, "c 12"] | None = None,
    gamma: Float[Tensor, "c 1"] | None = None,
    *,
    damp_grazing: bool = False,
) -> DualSurface:
    """The closed surface of a band on an octree, as ``grid_surface`` for cells of one size.

    Where a leaf has a crossing away from its own corners and edges, because smaller leaves touch it there, its alpha is
    interpolated linearly from the corners, and its beta from the edges of the same direction.
    """
    topology = octree_topology(band)
    repeated = topology.repeated()
    three = repeated.any(dim=1)
    mixed = bool(three.any())
    sizes = band.tree.grid.base_cell * torch.pow(0.5, levels_of(topology.keys).to(band.corner_sdf))
    vertices, deviation = dual_vertices(
        topology,
        band.corner_positions,
        band.corner_sdf,
        sizes,
        alpha=None if alpha is None else alpha @ _alpha_to_points(alpha.device, alpha.dtype),
        beta=None if beta is None else beta @ _beta_to_slots(beta.device, beta.dtype),
        used=torch.nonzero(~repeated.reshape(-1)).squeeze(1) if mixed else None,
        damp_grazing=damp_grazing,
    )
    return DualSurface(
        surface=_triangulated(topology, torch.nonzero(~three).squeeze(1), vertices, gamma, split),
        edge_sdf=band.corner_sdf.index_select(0, topology.ends.reshape(-1)).reshape(-1, 2),
        deviation=deviation,
    )


def _triangulated(
    topology: OctreeTopology,
    four: Int64[Tensor, " q"],
    vertices: Float[Tensor, "d 3"],
    gamma: Float[Tensor, "c 1"] | None,
    split: Split,
) -> Surface:
    """The quads at the edges ``four``, split, then the triangles of the others, which are left whole."""
    cells, axis, keys = topology.cells, topology.axis, topology.keys + DESCENDING_PART * topology.descending
    surface = split_quads(vertices, topology.vertices[four], cells[four], axis[four], keys[four], gamma, split)
    repeated = topology.repeated()
    three, place = torch.nonzero(repeated, as_tuple=True)
    whole = topology.vertices[three][~repeated[three]].reshape(-1, 3)
    return Surface(
        vertices=surface.vertices,
        faces=torch.cat([surface.faces, whole]),
        face_keys=torch.cat([surface.face_keys, keys[three] + (axis[three] + TRIANGLE_PRIMITIVE << PART_BITS) + place]),
    )


@cache
def _alpha_to_points(device: torch.device, dtype: torch.dtype) -> Float[Tensor, "8 27"]:
    """Trilinear shares of the corners in the lattice points."""
    shares = torch.ones(8, 27, dtype=dtype)
    for corner, point in enumerate(CORNER_POINTS):
        for lattice in range(27):
            for stride in (1, 3, 9):
                shares[corner, lattice] *= 1 - abs(point // stride % 3 - lattice // stride % 3) / 2
    return shares.to(device)


@cache
def _beta_to_slots(device: torch.device, dtype: torch.dtype) -> Float[Tensor, "12 36"]:
    """Shares of the edges in the slots: an edge is its own, and a line within a face half of the two beside it."""
    shares = torch.zeros(12, SLOTS, dtype=dtype)
    for axis in range(3):
        for lower in range(27):
            point = (lower % 3, lower // 3 % 3, lower // 9)
            slot = slot_of(axis, point) if point[axis] < 2 else -1
            for edge in range(4 * axis, 4 * axis + 4):
                end = EDGE_ENDS[edge][0]
                apart = [abs(point[a] - (end // 3**a) % 3) / 2 for a in AXES[axis][1:]]
                if slot >= 0:
                    shares[edge, slot] = (1 - apart[0]) * (1 - apart[1])
    return shares.to(device)
