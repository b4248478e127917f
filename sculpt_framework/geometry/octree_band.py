"""The narrow band on an octree: the leaves the zero level set passes through, followed and split until all is well.

As ``geometry.band`` for one level; the numbering and what counts as inside are the same. What a leaf sees of the
surface is what its whole boundary shows, and where finer leaves touch it the boundary has their vertices too. A
*hidden* crossing is one that the leaf's corners do not tell of: the middle of an edge differs in sign from both its
ends, or the middle of a face from the middles of all its edges. A leaf with one is split. In the end every edge of a
leaf is crossed once if its ends differ and not at all if they agree, and no contour closes within a face.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import (
    FACE_CORNERS,
    WALL_SDF,
    CornerSampler,
    cases_of,
    find,
    levels_of,
    parents,
    sample_corners,
)
from sculpt_framework.geometry.grid import Grid, pack, unpack_ijk
from sculpt_framework.geometry.octree import (
    EDGE_ENDS,
    EDGE_POINTS,
    FACE_EDGES,
    FACE_POINTS,
    FACE_STEPS,
    FinerNeighbours,
    Octree,
    WantedLevels,
    along,
    corner_keys,
    finer_neighbours,
    holding_leaves,
    key_steps,
    lattice_keys,
    lattice_number,
    leaves_at,
    split,
    tree_around,
    vertex_level,
)
from sculpt_framework.geometry.signed_distance import EmptySurfaceError


def face_lattice(face: int) -> list[list[int]]:
    """Lattice points of a face: row q, column p lies p, q half sides along the two axes after the face's own."""
    axis, side = divmod(face, 2)
    return [[lattice_number(*along(axis, 2 * side, p, q)) for p in range(3)] for q in range(3)]


def quarter_corners(face: int) -> list[list[int]]:
    """Lattice points round each quarter of a face. Quarter p + 2q lies at p, q along the two axes after the face's."""
    point = face_lattice(face)
    return [[point[q][p], point[q][p + 1], point[q + 1][p + 1], point[q + 1][p]] for q in (0, 1) for p in (0, 1)]


_QUARTERS = [quarter_corners(face) for face in range(6)]
_FACE_LATTICES = [[point for row in face_lattice(face) for point in row] for face in range(6)]
# From twice a cell's coordinates to those of the finer cell beyond each quarter of each face.
_BEYOND_QUARTERS = [
    [
        [2 * n + m for n, m in zip(step, along(face // 2, 1 - face % 2, p, q), strict=True)]
        for q in (0, 1)
        for p in (0, 1)
    ]
    for face, step in enumerate(FACE_STEPS)
]


@dataclass(frozen=True, kw_only=True, eq=False)
class OctreeBand:
    """The leaves that the surface passes through, and everything on their boundaries.

    Closed: of every face, and of every quarter of a face where leaves of two levels meet, whose vertices differ in
    sign, the leaves on both sides are here.
    """

    tree: Octree
    cells: Int64[Tensor, " c"]
    """Keys of the leaves, ascending: coarse ones first."""
    cases: Int64[Tensor, " c"]
    """Which corners are inside, as bits; never 0 nor 255."""
    corners: Int64[Tensor, " n"]
    """Keys of all vertices on the leaves' boundaries, ascending."""
    cell_corners: Int64[Tensor, "c 8"]
    """Rows of the corners of each leaf."""
    uneven: Int64[Tensor, " t"]
    """Rows of the leaves that finer leaves touch at a face or an edge, ascending."""
    lattice: Int64[Tensor, "t 27"]
    """Rows of the vertices at the lattice points of the uneven leaves, -1 where there is none."""
    corner_positions: Float[Tensor, "n 3"]
    corner_sdf: Float[Tensor, " n"]


def track_octree(
    sample: CornerSampler, tree: Octree, seeds: Int64[Tensor, " s"], wanted_levels: WantedLevels = levels_of
) -> OctreeBand:
    """Follow the surface from the leaves at the ``seeds``, cells of any level, until the band is closed.

    Leaves with surface are split until they have the wanted level, and leaves with hidden crossings until they have
    none; the tree of the band is the one that comes of it. Each vertex is sampled exactly once, by its key at
    ``vertex_level``. On the wall of the grid the sdf is raised to ``WALL_SDF`` cells of the roots' size. What comes out
    depends on the seeds only through the components of the surface that they meet.

    Raises EmptySurfaceError where no leaf reached changes sign, FloatingPointError where a sampled sdf is not finite.
    """
    return _settle(_Samples(sample, tree.grid, seeds.device), tree, seeds, wanted_levels)


def grow_octree(
    sample: CornerSampler, grid: Grid, seeds: Int64[Tensor, " s"], wanted_levels: WantedLevels
) -> OctreeBand:
    """``track_octree`` from the seeds that have surface, on the smallest tree that has them.

    So the tree too depends on the surface and on what is wanted, and not on cells named without need. A seed has
    surface if its corners differ in sign, or failing that, those of the root it lies in.
    """
    samples = _Samples(sample, grid, seeds.device)
    met = samples.differ(corner_keys(grid, seeds))
    tree = tree_around(grid, seeds[met])
    roots = seeds[~met]
    while bool((deeper := levels_of(roots) > grid.level).any()):
        roots = torch.where(deeper, parents(roots), roots)
    roots = roots.unique()
    roots = roots[~tree.is_split(roots)]
    cells = torch.cat([seeds[met], roots[samples.differ(corner_keys(grid, roots))]])
    if cells.shape[0] == 0:
        raise EmptySurfaceError(f"the signed distance has one sign at the corners of all {len(seeds)} cells tried")
    return _settle(samples, tree, cells, wanted_levels)


def _settle(samples: "_Samples", tree: Octree, cells: Int64[Tensor, " s"], wanted_levels: WantedLevels) -> OctreeBand:
    """Splitting shows more of the surface, which may ask for more splitting. What a leaf has shown remains, so the
    outcome does not depend on the order."""
    if bool((levels_of(cells) < tree.grid.level).any()):
        raise ValueError(
            f"seeds belong to coarser levels than the grid's {tree.grid.level}; use children() to refine them"
        )
    while True:
        look = _follow(samples, tree, leaves_at(tree, cells))
        unfit = levels_of(look.cells) < wanted_levels(look.cells)
        unfit[look.uneven] |= look.hidden
        if not bool(unfit.any()):
            return _band(samples, tree, look)
        tree, cells = split(tree, look.cells[unfit]), look.cells


@dataclass(frozen=True, kw_only=True, eq=False)
class _Look:
    """What is seen at some leaves. Vertices are given by the numbers of their samples."""

    cells: Int64[Tensor, " c"]
    cases: Int64[Tensor, " c"]
    corners: Int64[Tensor, "c 8"]
    uneven: Int64[Tensor, " t"]
    lattice: Int64[Tensor, "t 27"]
    hidden: Bool[Tensor, " t"]
    """Whether there is a hidden crossing."""


class _Samples:
    """Vertices and their samples, which are numbered in the order they are taken."""

    def __init__(self, sample: CornerSampler, grid: Grid, device: torch.device):
        self._sample = sample
        self._grid = grid.at_level(vertex_level(grid))
        self._wall_sdf = WALL_SDF * grid.cell
        self._known = torch.zeros(0, dtype=torch.int64, device=device)
        self._number = torch.zeros(0, dtype=torch.int64, device=device)
        self._positions: list[Tensor] = []
        self._values: list[Tensor] = []
        self.inside = torch.zeros(0, dtype=torch.bool, device=device)
        """By number."""

    def take(self, keys: Int64[Tensor, "*shape"]) -> Int64[Tensor, "*shape"]:
        """Numbers of vertices, which are sampled if they have not been yet."""
        wanted, rows = torch.unique(keys, return_inverse=True)
        fresh = wanted[~find(self._known, wanted)[1]]
        if fresh.shape[0] > 0:
            position, value = sample_corners(self._sample, self._grid, fresh, self._wall_sdf)
            self._positions.append(position)
            self._values.append(value)
            number = torch.arange(len(fresh), device=fresh.device) + len(self.inside)
            self._known, order = torch.cat([self._known, fresh]).sort()
            self._number = torch.cat([self._number, number])[order]
            self.inside = torch.cat([self.inside, value.detach() < 0])
        return self._number[find(self._known, wanted)[0]][rows]

    def differ(self, keys: Int64[Tensor, "c 8"]) -> Bool[Tensor, " c"]:
        """Whether not all of a cell's corners, which are sampled, have one sign."""
        number = self.take(keys)
        inside = self.inside[number]
        return inside.any(dim=1) & ~inside.all(dim=1)

    def ordered(
        self, used: Bool[Tensor, " n"]
    ) -> tuple[Int64[Tensor, " m"], Int64[Tensor, " n"], Float[Tensor, "m 3"], Float[Tensor, " m"]]:
        """Keys, ascending, of the vertices in use, the row there of each number, and positions and sdf by row."""
        kept = used[self._number]
        number = self._number[kept]
        row = torch.full_like(self._number, -1)
        row[number] = torch.arange(len(number), device=number.device)
        positions, values = torch.cat(self._positions), torch.cat(self._values)
        return self._known[kept], row, positions.index_select(0, number), values.index_select(0, number)


def _follow(samples: _Samples, tree: Octree, leaves: Int64[Tensor, " s"]) -> _Look:
    """The leaves with surface among the given ones and all that are reached from these across crossed faces."""
    visited, frontier = leaves[:0], leaves
    looks: list[_Look] = []
    while frontier.shape[0] > 0:
        look, beyond = _look(samples, tree, frontier)
        looks.append(look)
        visited = torch.cat([visited, frontier]).sort().values
        # Most are there under their own key; only the others can lie in a larger leaf.
        beyond = beyond[~find(visited, beyond)[1]]
        beyond = holding_leaves(tree, beyond).unique()
        frontier = beyond[~find(visited, beyond)[1]]
    if sum(len(look.cells) for look in looks) == 0:
        raise EmptySurfaceError(f"the signed distance has one sign at the corners of all {len(visited)} cells tried")
    return _joined(looks)


def _look(samples: _Samples, tree: Octree, cells: Int64[Tensor, " f"]) -> tuple[_Look, Int64[Tensor, " b"]]:
    """The leaves with surface among the given ones, and the cells beyond their crossed faces and quarters of faces.

    A cell beyond is a leaf, or would be one if the leaf that holds it were split.
    """
    device = cells.device
    corners = samples.take(corner_keys(tree.grid, cells))
    cases = cases_of(samples.inside[corners])
    masks = torch.tensor(FACE_CORNERS, device=device)
    part = cases[:, None] & masks
    crossed = (part > 0) & (part < masks)

    finer = finer_neighbours(tree, cells)
    uneven, vertices = finer.rows, finer.vertices()
    lattice = torch.full(vertices.shape, -1, device=device)
    lattice[vertices] = samples.take(lattice_keys(tree.grid, cells[uneven])[vertices])
    inside = vertices & samples.inside[lattice]
    outside = vertices & ~inside
    face_points = torch.tensor(_FACE_LATTICES, device=device)
    crossed[uneven] = inside[:, face_points].any(dim=2) & outside[:, face_points].any(dim=2)
    has_surface = crossed.any(dim=1)

    quarters = torch.tensor(_QUARTERS, device=device)
    crossed_quarters = inside[:, quarters].any(dim=3) & outside[:, quarters].any(dim=3) & finer.faces[..., None]
    doubled = 2 * unpack_ijk(cells[uneven])[:, None, None] + torch.tensor(_BEYOND_QUARTERS, device=device)
    level = (levels_of(cells[uneven]) + 1)[:, None, None].expand(crossed_quarters.shape)
    whole = crossed.clone()
    whole[uneven] &= ~finer.faces
    beyond = torch.cat(
        [
            (cells[:, None] + key_steps(FACE_STEPS, device))[whole],
            pack(level[crossed_quarters], doubled[crossed_quarters]),
        ]
    ).unique()

    row = has_surface.cumsum(0) - 1
    kept = has_surface[uneven]
    return _Look(
        cells=cells[has_surface],
        cases=cases[has_surface],
        corners=corners[has_surface],
        uneven=row[uneven[kept]],
        lattice=lattice[kept],
        hidden=_hidden(inside, finer)[kept],
    ), beyond


def _hidden(inside: Bool[Tensor, "t 27"], finer: FinerNeighbours) -> Bool[Tensor, " t"]:
    """Whether an edge's middle differs from both its ends, or a face's middle from the middles of all its edges."""
    ends = inside[:, torch.tensor(EDGE_ENDS, device=inside.device)]
    middle = inside[:, EDGE_POINTS]
    on_edges = finer.edges & (ends[..., 0] == ends[..., 1]) & (middle != ends[..., 0])
    around = middle[:, torch.tensor(FACE_EDGES, device=inside.device)]
    on_faces = finer.faces & (around != inside[:, FACE_POINTS][..., None]).all(dim=2)
    return on_edges.any(dim=1) | on_faces.any(dim=1)


def _joined(looks: list[_Look]) -> _Look:
    """Looks at different leaves as one, in ascending order of the leaves."""
    cells, order = torch.cat([look.cells for look in looks]).sort()
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(order), device=order.device)
    begins = torch.tensor([0, *(len(look.cells) for look in looks[:-1])]).cumsum(0).tolist()
    uneven = torch.cat([rank[begin + look.uneven] for begin, look in zip(begins, looks, strict=True)])
    uneven, order_of_uneven = uneven.sort()
    return _Look(
        cells=cells,
        cases=torch.cat([look.cases for look in looks])[order],
        corners=torch.cat([look.corners for look in looks])[order],
        uneven=uneven,
        lattice=torch.cat([look.lattice for look in looks])[order_of_uneven],
        hidden=torch.cat([look.hidden for look in looks])[order_of_uneven],
    )


def _band(samples: _Samples, tree: Octree, look: _Look) -> OctreeBand:
    used = torch.zeros_like(samples.inside)
    used[look.corners] = True
    used[look.lattice[look.lattice >= 0]] = True
    corners, row, positions, values = samples.ordered(used)
    return OctreeBand(
        tree=tree,
        cells=look.cells,
        cases=look.cases,
        corners=corners,
        cell_corners=row[look.corners],
        uneven=look.uneven,
        lattice=torch.where(look.lattice >= 0, row[look.lattice], -1),
        corner_positions=positions,
        corner_sdf=values,
    )
