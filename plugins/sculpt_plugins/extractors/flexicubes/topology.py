"""Connectivity of the dual surface: integers only, no geometry."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sculpt_framework.cpu_kernels import kernel_cache, share_threads
from sculpt_framework.geometry.band import Band
from sculpt_plugins.extractors.flexicubes.tables import AXES, DualTables, dual_tables

with kernel_cache("flexicubes-quads", Path(__file__).with_name("quad_kernels.py")):
    from sculpt_plugins.extractors.flexicubes import quad_kernels


@dataclass(frozen=True, kw_only=True, eq=False)
class DualTopology:
    """One row per grid edge with a sign change, which is one quad of the surface.

    The four cells round the edge, and so the quad's corners, are listed counter-clockwise seen from outside. The first
    is always the lowest cell, so the order depends only on the edge and on which of its ends is inside.
    """

    ends: Int64[Tensor, "e 2"]
    """Rows of the band's corners at the inner and the outer end."""
    cells: Int64[Tensor, "e 4"]
    """Rows of the band's cells."""
    cell_ends: Int64[Tensor, "e 4 2"]
    """Number, 0 to 7, of the inner and the outer end within each of the cells."""
    cell_edge: Int64[Tensor, "e 4"]
    """Number, 0 to 11, of the edge within each of the cells."""
    vertices: Int64[Tensor, "e 4"]
    """Dual vertex of each of the cells."""
    keys: Int64[Tensor, " e"]
    """Key of the edge's lower corner."""
    axis: Int64[Tensor, " e"]
    descending: Int64[Tensor, " e"]
    """1 where the inner end is the upper one, else 0."""
    vertex_count: int


def dual_topology(band: Band) -> DualTopology:
    tables = dual_tables(band.cells.device)
    inverted = _inverted_cells(band, tables).long()
    patch = tables.patch[inverted, band.cases]
    count = tables.patch_count[inverted, band.cases]
    first_vertex = count.cumsum(0) - count
    cell_vertices = patch + first_vertex[:, None]
    edges = crossed_edges_compiled if band.cells.device.type == "cpu" else crossed_edges_in_torch
    return edges(band, cell_vertices, int(count.sum()))


def crossed_edges_compiled(band: Band, cell_vertices: Int64[Tensor, "c 12"], vertex_count: int) -> DualTopology:
    """As ``crossed_edges_in_torch``, in compiled kernels for the CPU."""
    share_threads()
    axes, cases, cell_corners = np.array(AXES), band.cases.numpy(), band.cell_corners.numpy()
    per_axis = quad_kernels.count_edges(cases, axes)
    count = int(per_axis.sum())

    def numbers(*width: int) -> Int64[Tensor, "..."]:
        return torch.empty(count, *width, dtype=torch.int64)

    found = DualTopology(
        ends=numbers(2),
        cells=numbers(4),
        cell_ends=numbers(4, 2),
        cell_edge=numbers(4),
        vertices=numbers(4),
        keys=numbers(),
        axis=numbers(),
        descending=numbers(),
        vertex_count=vertex_count,
    )
    quad_kernels.list_edges(
        axes, per_axis.cumsum() - per_axis, cases, band.corners.numpy(), cell_corners, band.cell_at_corner.numpy(),
        cell_vertices.numpy(), found.ends.numpy(), found.cells.numpy(), found.cell_ends.numpy(),
        found.cell_edge.numpy(), found.vertices.numpy(), found.keys.numpy(), found.axis.numpy(),
        found.descending.numpy(),
    )  # fmt: skip
    return found


def crossed_edges_in_torch(band: Band, cell_vertices: Int64[Tensor, "c 12"], vertex_count: int) -> DualTopology:
    """The edges with a sign change, axis by axis. ``cell_vertices`` are the dual vertices on the edges of each cell."""
    per_axis = [_edges_along(band, cell_vertices, axis) for axis in range(3)]
    return DualTopology(
        ends=torch.cat([edges.ends for edges in per_axis]),
        cells=torch.cat([edges.cells for edges in per_axis]),
        cell_ends=torch.cat([edges.cell_ends for edges in per_axis]),
        cell_edge=torch.cat([edges.cell_edge for edges in per_axis]),
        vertices=torch.cat([edges.vertices for edges in per_axis]),
        keys=torch.cat([edges.keys for edges in per_axis]),
        axis=torch.cat([edges.axis for edges in per_axis]),
        descending=torch.cat([edges.descending for edges in per_axis]),
        vertex_count=vertex_count,
    )


def _inverted_cells(band: Band, tables: DualTables) -> Bool[Tensor, " c"]:
    """Cells that use the inverted table: both cells at a face that is troubled in both of them."""
    troubled = tables.troubled_face[band.cases]
    inverted = torch.zeros_like(troubled, dtype=torch.bool)
    for axis in range(3):
        lower = torch.nonzero(troubled == 2 * axis + 1).squeeze(1)
        upper = band.neighbour(lower, 1 << axis)
        # A troubled cell has one ambiguous face, so the upper cell's is this one.
        both = troubled[upper] == 2 * axis
        inverted[lower[both]] = True
        inverted[upper[both]] = True
    return inverted


def _edges_along(band: Band, cell_vertices: Int64[Tensor, "c 12"], axis: int) -> DualTopology:
    """The crossed edges along one axis. ``vertex_count`` is that of all axes and not filled in."""
    device = band.cells.device
    _, b, c = AXES[axis]
    # Seen from the lowest of its four cells the edge runs up from corner ``near``.
    near = 1 << b | 1 << c
    far = near | 1 << axis
    lower_inside, upper_inside = band.cases >> near & 1, band.cases >> far & 1
    owner = torch.nonzero(lower_inside != upper_inside).squeeze(1)
    descending = upper_inside[owner]

    # Small tables, first index: whether the edge is descending. The four cells lie at these corners of the lowest one,
    # counter-clockwise round the axis; with the normal the other way, the other way round.
    around = torch.tensor([[0, 1 << b, near, 1 << c], [0, 1 << c, near, 1 << b]], device=device)
    lower = near ^ around
    ends = torch.stack([lower, lower | 1 << axis], dim=2)
    ends[1] = ends[1].flip(1)
    cell_edge = (4 * axis + (lower >> b & 1) + 2 * (lower >> c & 1))[descending]

    cells = band.neighbour(owner[:, None], around[descending])
    band_ends = torch.tensor([[near, far], [far, near]], device=device)
    return DualTopology(
        ends=band.cell_corners[owner[:, None], band_ends[descending]],
        cells=cells,
        cell_ends=ends[descending],
        cell_edge=cell_edge,
        vertices=cell_vertices[cells, cell_edge],
        keys=band.corners[band.cell_corners[owner, near]],
        axis=torch.full_like(owner, axis),
        descending=descending,
        vertex_count=0,
    )
