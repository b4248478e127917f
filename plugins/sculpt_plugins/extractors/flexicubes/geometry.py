"""Geometry of the dual surface: pure, differentiable functions of a fixed connectivity."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.cpu_kernels import float32_on_cpu
from sculpt_framework.geometry.band import LEAST_DROP, crossing_weight
from sculpt_framework.geometry.faces import smallest_angles
from sculpt_plugins.extractors.flexicubes.compiled import dual_vertices_compiled, second_diagonals_compiled
from sculpt_plugins.extractors.flexicubes.octree_topology import OctreeTopology
from sculpt_plugins.extractors.flexicubes.topology import DualTopology

PREFERRED_BY = 0.05
"""Radians by which the second diagonal must be better than the first: on a square quad, the most common one, both are
equal up to rounding, and the choice, which is part of the face's name, should not flicker."""


def dual_vertices(
    topology: DualTopology | OctreeTopology,
    corner_positions: Float[Tensor, "n 3"],
    corner_sdf: Float[Tensor, " n"],
    cell: float | Float[Tensor, " e"],
    alpha: Float[Tensor, "c a"] | None = None,
    beta: Float[Tensor, "c b"] | None = None,
    used: Int64[Tensor, " m"] | None = None,
    damp_grazing: bool = False,
) -> tuple[Float[Tensor, "d 3"], Float[Tensor, " d"]]:
    """Positions of the dual vertices, and of each the mean absolute deviation of its distances to its crossings.

    On every edge of its loop a cell sees the crossing u = (a_o x_i + a_i x_o) / (a_i + a_o), with a = alpha |sdf| at
    the inner and outer end; the vertex is the mean of these, weighted by beta. ``alpha`` and ``beta`` are positive and
    1 where they are not given; their columns are what ``cell_ends`` and ``cell_edge`` of the topology count. ``cell``
    is the length of the edges. ``used`` names the places, of the 4 e of all edges, that count; default: all of them.
    Crossings and gradients stay finite where both ends are 0 (``crossing_weight``). With ``damp_grazing`` the gradient
    of a crossing is lessened where a grows by less than the edge's length along it, in proportion. A vertex none of
    whose places is used is NaN. In compiled kernels for float32 on the CPU, else in torch.
    """
    tensors = [tensor for tensor in (corner_positions, corner_sdf, alpha, beta) if tensor is not None]
    if not float32_on_cpu(*tensors):
        return dual_vertices_in_torch(topology, corner_positions, corner_sdf, cell, alpha, beta, used, damp_grazing)
    edges = topology.ends.shape[0]
    rows = int(topology.cells.max()) + 1 if edges else 0
    return dual_vertices_compiled(
        topology,
        corner_positions,
        corner_sdf,
        cell if isinstance(cell, Tensor) else torch.full((edges,), cell),
        torch.ones(rows, int(topology.cell_ends.max()) + 1 if edges else 0) if alpha is None else alpha,
        torch.ones(rows, int(topology.cell_edge.max()) + 1 if edges else 0) if beta is None else beta,
        torch.arange(4 * edges) if used is None else used,
        damp_grazing,
    )


def dual_vertices_in_torch(
    topology: DualTopology | OctreeTopology,
    corner_positions: Float[Tensor, "n 3"],
    corner_sdf: Float[Tensor, " n"],
    cell: float | Float[Tensor, " e"],
    alpha: Float[Tensor, "c a"] | None = None,
    beta: Float[Tensor, "c b"] | None = None,
    used: Int64[Tensor, " m"] | None = None,
    damp_grazing: bool = False,
) -> tuple[Float[Tensor, "d 3"], Float[Tensor, " d"]]:
    """``dual_vertices`` in plain torch: any device and floating-point type."""
    side = cell[:, None] if isinstance(cell, Tensor) else cell
    ends = corner_positions.index_select(0, topology.ends.reshape(-1)).reshape(-1, 2, 3)
    reach = corner_sdf.index_select(0, topology.ends.reshape(-1)).reshape(-1, 1, 2).abs()
    if alpha is not None:
        reach = reach * _entries(alpha, topology.cells[..., None], topology.cell_ends)
    weight = crossing_weight(reach[..., 0], reach[..., 1], LEAST_DROP * side, side if damp_grazing else None)
    inner, outer = ends[:, None, 0], ends[:, None, 1]
    crossings = (inner + weight[..., None] * (outer - inner)).expand(-1, 4, 3).reshape(-1, 3)

    vertex = topology.vertices.reshape(-1)
    share = None if beta is None else _entries(beta, topology.cells, topology.cell_edge).reshape(-1)
    if used is not None:
        vertex, crossings = vertex[used], crossings.index_select(0, used)
        share = None if share is None else share.index_select(0, used)
    if share is None:
        total = torch.bincount(vertex, minlength=topology.vertex_count).to(crossings)
        summed = crossings.new_zeros(topology.vertex_count, 3).index_add(0, vertex, crossings)
    else:
        total = share.new_zeros(topology.vertex_count).index_add(0, vertex, share)
        summed = crossings.new_zeros(topology.vertex_count, 3).index_add(0, vertex, crossings * share[:, None])
    vertices = summed / total[:, None]
    return vertices, _deviation(vertices, crossings, vertex)


def _entries(
    table: Float[Tensor, "c n"], row: Int64[Tensor, "..."], column: Int64[Tensor, "..."]
) -> Float[Tensor, "..."]:
    """``table[row, column]``, whose backward adds in the same order in every run."""
    where = row * table.shape[1] + column
    return table.reshape(-1).index_select(0, where.reshape(-1)).reshape(where.shape)


def _deviation(
    vertices: Float[Tensor, "d 3"], crossings: Float[Tensor, "m 3"], vertex: Int64[Tensor, " m"]
) -> Float[Tensor, " d"]:
    """Mean absolute deviation, at each vertex, of its distances to its crossings. The gradient at distance 0 is 0."""
    distance = torch.linalg.vector_norm(vertices.index_select(0, vertex) - crossings, dim=1)
    count = torch.bincount(vertex, minlength=vertices.shape[0]).to(distance)
    zeros = distance.new_zeros(vertices.shape[0])
    mean = zeros.index_add(0, vertex, distance) / count
    return zeros.index_add(0, vertex, (distance - mean.index_select(0, vertex)).abs()) / count


def diagonal_split(
    vertices: Float[Tensor, "d 3"], quads: Int64[Tensor, "e 4"]
) -> tuple[Int64[Tensor, "e 2 3"], Bool[Tensor, " e"]]:
    """Two triangles per quad, and whether they meet along its second diagonal (1-3) and not its first (0-2).

    The diagonal with the larger smallest angle wins, unless it folds the quad over and the other one does not.
    """
    if float32_on_cpu(vertices):
        use_second = second_diagonals_compiled(vertices, quads, PREFERRED_BY)
    else:
        use_second = second_diagonals_in_torch(vertices, quads)
    a, b, c, d = quads.unbind(1)
    # (a, b, c) and (a, c, d), or (a, b, d) and (b, c, d).
    corners = [a, b, torch.where(use_second, d, c), torch.where(use_second, b, a), c, d]
    return torch.stack(corners, dim=1).reshape(-1, 2, 3), use_second


def second_diagonals_in_torch(vertices: Float[Tensor, "d 3"], quads: Int64[Tensor, "e 4"]) -> Bool[Tensor, " e"]:
    """Which quads ``diagonal_split`` splits along their second diagonal, on any device."""
    # Coordinates come first and quads last: short last dimensions cost torch several times as much.
    corner = vertices.detach().T.contiguous().index_select(1, quads.T.reshape(-1)).reshape(3, 4, -1)
    side = corner.roll(-1, dims=1) - corner
    diagonal = corner[:, 2:] - corner[:, :2]
    # Triangle n is (n, n + 1, n + 2): 0 and 2 share the first diagonal, 1 and 3 the second.
    area_vector = torch.linalg.cross(side, side.roll(-1, dims=1), dim=0)
    lengths = side.square().sum(dim=0)
    squares = torch.stack([lengths, lengths.roll(-1, dims=0), diagonal.square().sum(dim=0).repeat(2, 1)])
    angle = smallest_angles(squares.movedim(0, -1), area_vector.square().sum(dim=0).sqrt())
    folded = (area_vector[:, :2] * area_vector[:, 2:]).sum(dim=0) < 0
    score = torch.minimum(angle[:2], angle[2:]) - torch.pi * folded
    return score[1] > score[0] + PREFERRED_BY


def center_split(
    vertices: Float[Tensor, "d 3"], quads: Int64[Tensor, "e 4"], gamma: Float[Tensor, "e 4"] | None = None
) -> tuple[Int64[Tensor, "e 4 3"], Float[Tensor, "e 3"]]:
    """Four triangles round the centre of each quad, and the centres, which are numbered after the vertices.

    The centre is a mean of the middles of the two diagonals, each weighted by the product of gamma > 0 of the cells at
    its ends, so that gamma can bend the quad towards either diagonal; without gamma it is the mean of the corners.
    """
    corner = vertices.index_select(0, quads.reshape(-1)).reshape(-1, 4, 3)
    diagonals = corner[:, :2] + corner[:, 2:]
    if gamma is None:
        centers = 0.25 * diagonals.sum(dim=1)
    else:
        weight = gamma[:, :2] * gamma[:, 2:]
        centers = (weight[..., None] * diagonals).sum(dim=1) / (2 * weight.sum(dim=1, keepdim=True))
    center = torch.arange(quads.shape[0], device=quads.device) + vertices.shape[0]
    return torch.stack([quads, quads.roll(-1, dims=1), center[:, None].expand(-1, 4)], dim=2), centers
