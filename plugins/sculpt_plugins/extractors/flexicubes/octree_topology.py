"""Connectivity of the dual surface on an octree: integers only, no geometry.

A *minimal edge* is an edge of a leaf that is not halved by a smaller one beside it. Round each that the surface crosses
lie four leaves, or three where a larger leaf takes two of the four places; their dual vertices are the corners of one
polygon. Two leaves that follow each other round the edge share a square of their boundaries, so the polygon's side is
the join in that square that ends at the edge: every join is a side of exactly two polygons, and the polygons at a dual
vertex follow each other as the crossings on its cycle do. With no square troubled (``octree_cycles``) two dual vertices
share one side at most, and with no crossing hidden no two polygons share more than one side: the mesh is closed and
manifold, whatever the levels.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sculpt_framework.geometry.band import levels_of, parents
from sculpt_framework.geometry.grid import PART_BITS, unpack_ijk
from sculpt_framework.geometry.keys import find
from sculpt_framework.geometry.octree import AXES, EDGE_POINTS, along, key_steps, lattice_number, levels_in
from sculpt_framework.geometry.octree_band import OctreeBand
from sculpt_plugins.extractors.flexicubes.octree_cycles import square_tables
from sculpt_plugins.extractors.flexicubes.octree_patches import patches_of
from sculpt_plugins.extractors.flexicubes.tables import EDGES

QUADRANTS = (((0, 0), (1, 0), (1, 1), (0, 1)), ((0, 0), (0, 1), (1, 1), (1, 0)))
"""Places round an edge, below (0) or above it on the two axes after its own: counter-clockwise seen from its upper end
and, second, from its lower end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OctreeTopology:
    """One row per crossed minimal edge, which is one polygon of the surface.

    The leaves round the edge, and so the polygon's corners, are listed counter-clockwise seen from outside. The first
    is the one in the lowest place. A larger leaf that takes two places is listed twice.
    """

    ends: Int64[Tensor, "e 2"]
    """Rows of the band's corners at the inner and the outer end."""
    cells: Int64[Tensor, "e 4"]
    """Rows of the band's cells."""
    cell_ends: Int64[Tensor, "e 4 2"]
    """Lattice points of the inner and the outer end in each of the cells."""
    cell_edge: Int64[Tensor, "e 4"]
    """Slot of the edge in each of the cells."""
    vertices: Int64[Tensor, "e 4"]
    """Dual vertex of each of the cells."""
    keys: Int64[Tensor, " e"]
    """Key of the edge's lower corner; its level is that of the smallest leaves at the edge."""
    axis: Int64[Tensor, " e"]
    descending: Int64[Tensor, " e"]
    """1 where the inner end is the upper one, else 0."""
    vertex_count: int

    def repeated(self) -> Bool[Tensor, "e 4"]:
        """Places whose leaf takes the next place as well."""
        return self.cells == self.cells.roll(-1, dims=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Edges:
    """Crossed minimal edges. The rows of cells are -1 in places that a larger leaf takes."""

    keys: Int64[Tensor, " e"]
    axis: Int64[Tensor, " e"]
    lower: Int64[Tensor, " e"]
    upper: Int64[Tensor, " e"]
    descending: Int64[Tensor, " e"]
    cells: Int64[Tensor, "e 4"]


def octree_topology(band: OctreeBand) -> OctreeTopology:
    edges = _crossed_edges(band)
    device = band.cells.device
    axis, descending = edges.axis, edges.descending
    # Where the edge's lower end is in a cell of the edge's own size, by axis, direction and place.
    lowest = torch.tensor(
        [
            [[lattice_number(*along(a, 0, 2 - 2 * p, 2 - 2 * q)) for p, q in places] for places in QUADRANTS]
            for a in range(3)
        ],
        device=device,
    )
    lower = lowest[axis, descending]
    step = (2 * 3**axis)[:, None].expand(-1, 4)
    cells = edges.cells
    taken = cells < 0
    if bool(taken.any()):
        edge, place = torch.nonzero(taken, as_tuple=True)
        beyond = edges.keys[edge] + _quadrant_steps(device)[axis[edge], descending[edge], place]
        larger, there = find(band.cells, parents(beyond))
        assert bool(there.all()), "the band is closed"  # noqa: S101
        cells = cells.masked_scatter(taken, larger)
        point = unpack_ijk(edges.keys[edge]) - 2 * unpack_ijk(band.cells[larger])
        lower = lower.masked_scatter(taken, (point * torch.tensor([1, 3, 9], device=device)).sum(dim=1))
        step = torch.where(taken, step // 2, step)
    slot = square_tables(device).slot_of_edge[axis[:, None], lower]
    patches = patches_of(band)
    ends = torch.stack([edges.lower, edges.upper], dim=1)
    cell_ends = torch.stack([lower, lower + step], dim=2)
    turned = (descending == 1)[:, None]
    return OctreeTopology(
        ends=torch.where(turned, ends.flip(1), ends),
        cells=cells,
        cell_ends=torch.where(turned[..., None], cell_ends.flip(2), cell_ends),
        cell_edge=slot,
        vertices=patches.vertices(cells, slot),
        keys=edges.keys,
        axis=axis,
        descending=descending,
        vertex_count=patches.vertex_count,
    )


def _quadrant_steps(device: torch.device) -> Int64[Tensor, "3 2 4"]:
    """From the key of an edge's lower corner to those of the four cells of its size round it."""
    steps = [along(a, 0, p - 1, q - 1) for a in range(3) for places in QUADRANTS for p, q in places]
    return key_steps(steps, device).reshape(3, 2, 4)


def _crossed_edges(band: OctreeBand) -> _Edges:
    halved = torch.zeros(len(band.cells), 12, dtype=torch.bool, device=band.cells.device)
    halved[band.uneven] = band.lattice[:, EDGE_POINTS] >= 0
    found: list[_Edges] = []
    coarser = None
    for level, begin, end in levels_in(band.cells):
        rows = slice(begin, end)
        found += [_edges_above(band, rows, halved[rows, 4 * axis + 3], axis) for axis in range(3)]
        if coarser == level - 1:
            found.append(_edges_at_larger_leaves(band, rows, halved[rows], level))
        coarser = level
    return _Edges(**{each.name: torch.cat([getattr(part, each.name) for part in found]) for each in fields(_Edges)})


def _edges_above(band: OctreeBand, rows: slice, halved: Bool[Tensor, " c"], axis: int) -> _Edges:
    """Crossed minimal edges along an axis in whose lowest place lies one of the cells ``rows``, all of one level."""
    device = band.cells.device
    _, b, c = AXES[axis]
    near = 1 << b | 1 << c
    far = near | 1 << axis
    cases = band.cases[rows]
    lower_inside, upper_inside = cases >> near & 1, cases >> far & 1
    owner = torch.nonzero((lower_inside != upper_inside) & ~halved).squeeze(1)
    descending = upper_inside[owner]
    owner = owner + rows.start

    cell_at_corner = torch.full_like(band.corners, -1)
    cell_at_corner[band.cell_corners[rows, 0]] = torch.arange(rows.start, rows.stop, device=device)
    around = torch.tensor([[p << b | q << c for p, q in places] for places in QUADRANTS], device=device)
    return _Edges(
        keys=band.cells[owner] + key_steps([along(axis, 0, 1, 1)], device),
        axis=torch.full_like(owner, axis),
        lower=band.cell_corners[owner, near],
        upper=band.cell_corners[owner, far],
        descending=descending,
        cells=cell_at_corner[band.cell_corners[owner[:, None], around[descending]]],
    )


def _edges_at_larger_leaves(band: OctreeBand, rows: slice, halved: Bool[Tensor, "c 12"], level: int) -> _Edges:
    """Crossed minimal edges of the cells ``rows``, all of one level, in whose lowest place a larger leaf lies."""
    device = band.cells.device
    larger = band.lattice[levels_of(band.cells[band.uneven]) == level - 1]
    on_larger = torch.zeros_like(band.corners, dtype=torch.bool)
    on_larger[larger[larger >= 0]] = True
    corners = band.cell_corners[rows]
    touching = torch.nonzero(on_larger[corners].any(dim=1)).squeeze(1)

    lower, upper = torch.tensor(EDGES, device=device).unbind(dim=1)
    first, second = corners[touching][:, lower], corners[touching][:, upper]
    inside = band.corner_sdf.detach() < 0
    wanted = on_larger[first] & on_larger[second] & (inside[first] != inside[second]) & ~halved[touching]
    row, edge = torch.nonzero(wanted, as_tuple=True)
    first, second, axis = first[row, edge], second[row, edge], edge // 4
    base = [along(a, 0, p, q) for a in range(3) for q in (0, 1) for p in (0, 1)]
    keys = band.cells[rows][touching[row]] + key_steps(base, device)[edge]
    names, order = (keys + (axis << PART_BITS)).sort()
    distinct = torch.ones_like(names, dtype=torch.bool)
    distinct[1:] = names[1:] != names[:-1]
    order = order[distinct]
    descending = inside[second[order]].long()
    cells, there = find(band.cells, keys[order, None] + _quadrant_steps(device)[axis[order], descending])
    order, kept = order[~there[:, 0]], ~there[:, 0]
    return _Edges(
        keys=keys[order],
        axis=axis[order],
        lower=first[order],
        upper=second[order],
        descending=descending[kept],
        cells=torch.where(there, cells, -1)[kept],
    )
