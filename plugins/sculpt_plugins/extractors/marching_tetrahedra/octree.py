"""Marching tetrahedra on an octree: a split of leaves of all sizes into tetrahedra that fit together.

A leaf that no smaller one touches is split as a cell of a grid is (``tables``). Any other leaf is split into the
tetrahedra between its centre, which becomes a vertex, and the triangles of its boundary. Both leaves at a piece of a
boundary cut it into the same triangles: a square without further vertices along the diagonal from its lowest to its
highest corner, as in ``tables``; a whole face with vertices in the middle of some of its edges into the triangles
between the lowest of these and the sides away from it.
"""

from dataclasses import dataclass
from functools import cache

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import CornerSampler, sample_corners
from sculpt_framework.geometry.grid import unpack_ijk
from sculpt_framework.geometry.octree import FACE_POINTS, lattice_keys, vertex_level
from sculpt_framework.geometry.octree_band import OctreeBand, face_lattice
from sculpt_framework.geometry.tetrahedra import RIGHT_HANDED, triangles_of
from sculpt_plugins.extractors.marching_tetrahedra.tables import CODES_PER_TETRAHEDRON, TETRAHEDRA

CENTER = 13
"""Lattice point in the middle of a leaf."""
_MIDDLES = (1, 5, 7, 3)
"""Points of a face's lattice in the middle of its sides, in turn; its corners are 0, 2, 8, 6, its own middle is 4."""
_SIDES = (0, 1, 2, 5, 8, 7, 6, 3)
"""Corners and middles of sides, in turn."""
_TRIANGLES_PER_FACE = 8
CODE_BITS = 7
"""Of the name of a triangle in its cell, as many bits are the lowest of the face key. The others, which tetrahedra
round a centre need, lie above the level, which is below 16 in any grid: a key has 16 bits per coordinate."""
CODE_SHIFT = 59


@dataclass(frozen=True, kw_only=True, eq=False)
class Tetrahedra:
    """Tetrahedra with a sign change.

    Those with a number below 6 are the tetrahedra of a plain cell, in the order and with the corners in the order that
    ``tables`` has. From the first corner of any other, its leaf's centre, the edges to the rest are right-handed.
    """

    corners: Int64[Tensor, "t 4"]
    """Rows of vertices."""
    cells: Int64[Tensor, " t"]
    """Rows of cells."""
    numbers: Int64[Tensor, " t"]
    """Number of the tetrahedron in its cell."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cut:
    """The surface in tetrahedra, and what it is cut from."""

    ends: Int64[Tensor, "v 2"]
    """Rows of vertices at the inner and the outer end of the edge that each corner of a triangle lies on."""
    faces: Int64[Tensor, "f 3"]
    face_keys: Int64[Tensor, " f"]


def with_centers(
    band: OctreeBand, sample: CornerSampler
) -> tuple[Int64[Tensor, " m"], Float[Tensor, "m 3"], Float[Tensor, " m"]]:
    """Keys, positions and signed distances of the band's corners and, after these, of the centres of uneven leaves."""
    grid = band.tree.grid.at_level(vertex_level(band.tree.grid))
    if band.uneven.shape[0] == 0:
        return band.corners, band.corner_positions, band.corner_sdf
    centers = lattice_keys(band.tree.grid, band.cells[band.uneven])[:, CENTER]
    # A centre is never on the wall.
    positions, values = sample_corners(sample, grid, centers, 0.0)
    return (
        torch.cat([band.corners, centers]),
        torch.cat([band.corner_positions, positions]),
        torch.cat([band.corner_sdf, values]),
    )


def split_leaves(band: OctreeBand, inside: Tensor) -> Tetrahedra:
    """The tetrahedra with a sign change; ``inside`` tells of the corners and centres (``with_centers``)."""
    device = band.cells.device
    tables = _tables(device)
    plain = torch.ones_like(band.cells, dtype=torch.bool)
    plain[band.uneven] = False
    cells = torch.nonzero(plain).squeeze(1)
    whole = band.cell_corners[cells][:, tables.kuhn]
    number = torch.arange(whole.shape[1], device=device)

    lattice = band.lattice
    sides = lattice[:, tables.middles] >= 0
    pattern = (sides.long() << torch.arange(4, device=device)).sum(dim=2)
    pattern = torch.where(lattice[:, FACE_POINTS] >= 0, 16, pattern)
    points = tables.triangles[torch.arange(6, device=device), pattern]
    used = points[..., 0] >= 0
    outer = lattice.gather(1, points.clamp(min=0).flatten(1)).reshape(points.shape)
    center = len(band.corners) + torch.arange(len(lattice), device=device)
    around = torch.cat([center[:, None, None, None].expand(-1, 6, _TRIANGLES_PER_FACE, 1), outer], dim=3)
    uneven = band.uneven[:, None, None].expand(used.shape)
    counted = (len(number) + torch.arange(6 * _TRIANGLES_PER_FACE, device=device)).reshape(6, -1).expand(used.shape)

    corners = torch.cat([whole.reshape(-1, 4), around[used]])
    found = inside[corners]
    crossed = found.any(dim=1) & ~found.all(dim=1)
    return Tetrahedra(
        corners=corners[crossed],
        cells=torch.cat([cells.repeat_interleave(len(number)), uneven[used]])[crossed],
        numbers=torch.cat([number.repeat(len(cells)), counted[used]])[crossed],
    )


def march(band: OctreeBand, tetrahedra: Tetrahedra, inside: Tensor) -> Cut:
    """The triangles in the tetrahedra, outward, and the edges their corners lie on."""
    device = band.cells.device
    tables = _tables(device)
    case = (inside[tetrahedra.corners].long() << torch.arange(4, device=device)).sum(dim=1)
    kind = tetrahedra.numbers.clamp(max=len(TETRAHEDRA))
    count = tables.count[case]
    owner = torch.repeat_interleave(count)
    first = count.cumsum(0) - count
    which = torch.arange(len(owner), device=device) - first[owner]
    edges = tables.edges[kind[owner], case[owner], which]
    ends = tetrahedra.corners[owner[:, None, None], edges].reshape(-1, 2)
    names, vertex = torch.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True)
    code = tetrahedra.numbers[owner] * CODES_PER_TETRAHEDRON + tables.code[case[owner]] + which
    keys = band.cells[tetrahedra.cells[owner]]
    return Cut(
        ends=torch.stack([names >> 32, names & 0xFFFFFFFF], dim=1),
        faces=vertex.reshape(-1, 3),
        face_keys=keys + (code & (1 << CODE_BITS) - 1) + (code >> CODE_BITS << CODE_SHIFT),
    )


def edge_lengths(keys: Int64[Tensor, " m"], ends: Int64[Tensor, "v 2"], band: OctreeBand) -> Float[Tensor, " v"]:
    """Extent, along the axis where it is longest, of edges between vertices with these keys."""
    grid = band.tree.grid.at_level(vertex_level(band.tree.grid))
    ijk = unpack_ijk(keys)
    steps = (ijk[ends[:, 0]] - ijk[ends[:, 1]]).abs().amax(dim=1)
    return steps.to(band.corner_sdf) * grid.cell


# --------------------------------------------------------------------------------------------------------------- tables


@dataclass(frozen=True, kw_only=True, eq=False)
class _Tables:
    kuhn: Int64[Tensor, "6 4"]
    """Corners of the tetrahedra of a plain cell."""
    middles: Int64[Tensor, "6 4"]
    """Lattice points in the middle of the sides of each face, in turn."""
    triangles: Int64[Tensor, "6 17 8 3"]
    """Lattice points of the triangles of each face, counter-clockwise seen from outside, by which sides have a vertex
    in their middle, as bits; 16: the face is in quarters. -1 where there are fewer than 8."""
    count: Int64[Tensor, "16"]
    """Triangles in a tetrahedron, by its inside corners."""
    edges: Int64[Tensor, "7 16 2 3 2"]
    """Corners of the tetrahedron at the inner and the outer end of the edge each triangle corner lies on: of the six
    tetrahedra of a plain cell and of one round a centre."""
    code: Int64[Tensor, "16"]
    """Triangles in all cases before this one."""


@cache
def _tables(device: torch.device) -> _Tables:
    kinds = (*TETRAHEDRA, RIGHT_HANDED)
    counts = torch.tensor([len(triangles_of(RIGHT_HANDED, case)) for case in range(16)])
    return _Tables(
        kuhn=torch.tensor(TETRAHEDRA, device=device),
        middles=torch.tensor(
            [[point for row in face_lattice(face) for point in row] for face in range(6)], device=device
        )[:, _MIDDLES],
        triangles=torch.tensor([[_triangles(face, pattern) for pattern in range(17)] for face in range(6)]).to(device),
        count=counts.to(device),
        edges=torch.tensor([[_marched(kind, case) for case in range(16)] for kind in kinds], device=device),
        code=(counts.cumsum(0) - counts).to(device),
    )


def _triangles(face: int, pattern: int) -> list[list[int]]:
    """Triangles of a face, as lattice points of the leaf."""
    flat = [point for row in face_lattice(face) for point in row]
    if pattern == 16:
        squares = [(low, low + 1, low + 4, low + 3) for low in (0, 1, 3, 4)]
        found = [each for a, b, c, d in squares for each in ((a, b, c), (a, c, d))]
    elif pattern == 0:
        found = [(0, 2, 8), (0, 8, 6)]
    else:
        ring = [point for point in _SIDES if point not in _MIDDLES or pattern >> _MIDDLES.index(point) & 1]
        apex = min(point for point in ring if point in _MIDDLES)
        start = ring.index(apex)
        ring = ring[start:] + ring[:start]
        found = [(apex, ring[n], ring[n + 1]) for n in range(1, len(ring) - 1)]
    # These turn counter-clockwise seen from above; a lower face is seen from below.
    outward = face % 2 == 1
    turned = [(flat[a], flat[b], flat[c]) if outward else (flat[a], flat[c], flat[b]) for a, b, c in found]
    return [list(each) for each in turned] + [[-1] * 3] * (_TRIANGLES_PER_FACE - len(turned))


def _marched(tetrahedron: tuple[int, ...], case: int) -> list[list[tuple[int, int]]]:
    """The edges, inner end first, that the corners of the outward triangles lie on; two triangles, in use or not."""
    triangles = []
    for triangle in triangles_of(tetrahedron, case):
        ends = [(tetrahedron.index(low), tetrahedron.index(high)) for low, high in triangle]
        triangles.append([(low, high) if case >> low & 1 else (high, low) for low, high in ends])
    return (triangles + [[(0, 0)] * 3] * 2)[:2]
