"""A sparse octree: which cells of a grid are split into eight, and which of those again.

The roots are the cells of a ``Grid``, which are listed nowhere; kept are only the keys of the cells that are *split*. A
cell is in the tree if it is a root or its parent is split, and a leaf if it is in the tree and not split itself. Trees
are immutable: splitting, merging and balancing give new ones. Nothing but ``leaves`` lists the roots.

Balanced (2:1) means that leaves that touch, be it at a corner, differ by one level at most. Said of split cells: around
a split cell all 26 neighbours of its size are in the tree, so their parents are split.

Vertices are named by their position: a key packs the coordinates that the vertex has at ``vertex_level``, the finest
level a grid can have, so that cells of all levels agree on the vertices they share.

Numbering, beside that of ``geometry.band``. The lattice of a cell are the 27 points at multiples of half its side,
named x + 3 y + 9 z. Edge 4a + p + 2q of a cell runs along axis a, at p and q (0 or 1) on the two axes after a.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sculpt_framework.geometry.band import children, corner_offsets, levels_of, parents
from sculpt_framework.geometry.grid import MAX_CELLS_PER_AXIS, Grid, pack, unpack_ijk
from sculpt_framework.geometry.keys import find

AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
"""Each axis with the two that follow it: right-handed."""

WantedLevels = Callable[[Tensor], Tensor]
"""Keys "n" of cells to the levels "n" down to which the surface in them is to be split. A cell inside another one is
not wanted finer than that one."""


def lattice_number(x: int, y: int, z: int) -> int:
    """Name of the lattice point x, y, z half sides (0, 1 or 2) from corner 0."""
    return x + 3 * y + 9 * z


def along(axis: int, here: int, first: int, second: int) -> tuple[int, int, int]:
    """The point or step with these coordinates on ``axis`` and on the two axes after it."""
    place = dict(zip(AXES[axis], (here, first, second), strict=True))
    return place[0], place[1], place[2]


CORNER_POINTS = tuple(lattice_number(2 * (n & 1), 2 * (n >> 1 & 1), 2 * (n >> 2)) for n in range(8))
EDGE_POINTS = tuple(lattice_number(*along(a, 1, 2 * p, 2 * q)) for a in range(3) for q in (0, 1) for p in (0, 1))
"""Lattice point in the middle of each edge."""
FACE_POINTS = tuple(lattice_number(*along(a, 2 * side, 1, 1)) for a in range(3) for side in (0, 1))
"""Lattice point in the middle of each face."""
EDGE_ENDS = tuple(
    tuple(lattice_number(*along(a, end, 2 * p, 2 * q)) for end in (0, 2))
    for a in range(3)
    for q in (0, 1)
    for p in (0, 1)
)
"""Lattice points at the ends of each edge."""
FACE_STEPS = tuple(along(a, 2 * side - 1, 0, 0) for a in range(3) for side in (0, 1))
"""What the coordinates of a cell grow by across each face."""
_EDGE_STEPS = tuple(along(a, 0, 2 * p - 1, 2 * q - 1) for a in range(3) for q in (0, 1) for p in (0, 1))
_FACES_AT_EDGE = [(2 * AXES[a][1] + p, 2 * AXES[a][2] + q) for a in range(3) for q in (0, 1) for p in (0, 1)]
FACE_EDGES = tuple(tuple(edge for edge in range(12) if face in _FACES_AT_EDGE[edge]) for face in range(6))
"""The four edges round each face."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Octree:
    """A balanced tree. Make one by ``balanced``, ``tree_around`` or ``split``."""

    grid: Grid
    """The roots."""
    split_cells: Int64[Tensor, " s"]
    """Keys of all cells that are split, ascending: roots first, deeper levels after."""

    def is_split(self, cells: Int64[Tensor, " n"]) -> Bool[Tensor, " n"]:
        return find(self.split_cells, cells)[1]

    @property
    def finest_level(self) -> int:
        """Level of the smallest leaves."""
        if self.split_cells.shape[0] == 0:
            return self.grid.level
        return int(levels_of(self.split_cells[-1:])) + 1


@dataclass(frozen=True, kw_only=True, eq=False)
class FinerNeighbours:
    """Those of a list of leaves that finer leaves touch at an edge or a face."""

    rows: Int64[Tensor, " t"]
    """Rows of these leaves in the list, ascending."""
    edges: Bool[Tensor, "t 12"]
    """Whether a finer leaf lies at the edge, which then has a vertex in its middle."""
    faces: Bool[Tensor, "t 6"]
    """Whether four finer leaves lie at the face, which then has a vertex in its middle, and in those of its edges."""

    def vertices(self) -> Bool[Tensor, "t 27"]:
        """Which lattice points are vertices: the corners and the said middles."""
        present = torch.zeros(self.rows.shape[0], 27, dtype=torch.bool, device=self.rows.device)
        present[:, CORNER_POINTS] = True
        present[:, EDGE_POINTS] = self.edges
        present[:, FACE_POINTS] = self.faces
        return present


# ------------------------------------------------------------------------------------------------------------- building


def balanced(grid: Grid, cells: Int64[Tensor, " c"]) -> Octree:
    """The smallest balanced tree in which the given cells, in any order, are split.

    Raises ValueError for cells that are larger than the grid's, or too small to be split.
    """
    parts: list[Tensor] = []
    if cells.shape[0] > 0:
        level = levels_of(cells)
        coarsest, finest = int(level.min()), int(level.max())
        if coarsest < grid.level or finest >= vertex_level(grid):
            raise ValueError(
                f"cells of levels {coarsest} to {finest} cannot be split: roots have level {grid.level}, and "
                f"the finest level is {vertex_level(grid)}"
            )
        for current in range(finest, grid.level - 1, -1):
            needed = cells[level == current]
            if parts:
                needed = torch.cat([needed, _parents_around(grid.at_level(current + 1), parts[-1])])
            parts.append(needed.unique())
    return Octree(grid=grid, split_cells=torch.cat(parts[::-1]) if parts else cells)


def tree_around(grid: Grid, cells: Int64[Tensor, " c"]) -> Octree:
    """The smallest balanced tree that has the given cells, as leaves or split."""
    deeper = cells[levels_of(cells) > grid.level]
    return balanced(grid, parents(deeper).unique())


def split(tree: Octree, cells: Int64[Tensor, " c"]) -> Octree:
    """The tree with these cells split as well, and whatever must be split with them to keep it balanced."""
    return balanced(tree.grid, torch.cat([tree.split_cells, cells]))


def _parents_around(grid: Grid, cells: Int64[Tensor, " c"]) -> Int64[Tensor, " p"]:
    """Parents, some more than once, of the cells and of their 26 neighbours inside the grid, which is theirs.

    The neighbours lie in eight parents: the cell's own and those on the side, along each axis, where the cell lies.
    """
    ijk = unpack_ijk(cells)
    towards = 2 * (ijk & 1) - 1
    around = ((ijk >> 1)[:, None] + corner_offsets(cells.device) * towards[:, None]).reshape(-1, 3)
    shape = torch.tensor(grid.shape, device=cells.device)
    inside = ((around >= 0) & (2 * around < shape)).all(dim=1)
    return pack(grid.level - 1, around[inside])


# -------------------------------------------------------------------------------------------------------------- looking


def key_steps(offsets: Sequence[tuple[int, int, int]], device: torch.device) -> Int64[Tensor, " n"]:
    """What keys grow by where coordinates grow by these, which may be negative."""
    units = pack(0, torch.eye(3, dtype=torch.int64, device=device))
    return (torch.tensor(offsets, device=device) * units).sum(dim=1)


def leaves(tree: Octree) -> Int64[Tensor, " n"]:
    """Keys, ascending, of all leaves. Takes memory for all roots."""
    device = tree.split_cells.device
    ijk = torch.cartesian_prod(*(torch.arange(n, device=device) for n in tree.grid.shape))
    cells = torch.cat([pack(tree.grid.level, ijk), children(tree.split_cells)])
    return cells[~tree.is_split(cells)]


def holding_leaves(tree: Octree, cells: Int64[Tensor, " n"]) -> Int64[Tensor, " n"]:
    """The leaf each cell lies in, itself if it is one. The cells must not be split."""
    cells = cells.clone()
    rows = torch.nonzero(levels_of(cells) > tree.grid.level).squeeze(1)
    while rows.shape[0] > 0:
        above = parents(cells[rows])
        outside = ~tree.is_split(above)
        rows = rows[outside]
        cells[rows] = above[outside]
        rows = rows[levels_of(cells[rows]) > tree.grid.level]
    return cells


def leaves_at(tree: Octree, cells: Int64[Tensor, " n"]) -> Int64[Tensor, " m"]:
    """Keys, ascending and distinct, of the leaves that fill the given cells or hold them."""
    found = []
    while cells.shape[0] > 0:
        open_cells = tree.is_split(cells)
        found.append(holding_leaves(tree, cells[~open_cells]))
        cells = children(cells[open_cells])
    return torch.cat(found).unique() if found else cells


def heirs(old: Int64[Tensor, " n"], new: Int64[Tensor, " m"]) -> tuple[Int64[Tensor, " p"], Int64[Tensor, " p"]]:
    """Pairs of rows, of ``new`` and of ``old``, ascending lists of cells: who takes over from whom after a change.

    A new cell that is not an old one takes over from the smallest old cell that holds it, or if there is none, from the
    old cells that it holds.
    """
    alone = ~find(old, new)[1]
    orphans = torch.nonzero(alone).squeeze(1)
    rows, lenders = [], []
    above = new[orphans]
    while orphans.shape[0] > 0:
        row, there = find(old, above)
        rows.append(orphans[there])
        lenders.append(row[there])
        rest = ~there & (levels_of(above) > 0)
        orphans, above = orphans[rest], parents(above[rest])
    alone[torch.cat([new[:0], *rows])] = False
    coarsest = int(levels_of(new[alone]).min()) if bool(alone.any()) else levels_of(old).max()
    free = torch.nonzero(levels_of(old) > coarsest).squeeze(1)
    above = old[free]
    while free.shape[0] > 0:
        inner = levels_of(above) > 0
        free, above = free[inner], parents(above[inner])
        row, there = find(new, above)
        there &= alone[row]
        rows.append(row[there])
        lenders.append(free[there])
    return torch.cat([new[:0], *rows]), torch.cat([new[:0], *lenders])


def finer_neighbours(tree: Octree, cells: Int64[Tensor, " n"]) -> FinerNeighbours:
    """Where finer leaves touch the given leaves, which must be in ascending order."""
    device = cells.device
    rows = torch.nonzero(_near_split_cells(tree, cells)).squeeze(1)
    steps = key_steps(FACE_STEPS + _EDGE_STEPS, device)
    # Beyond the wall of the grid a key stands for no cell of the tree.
    finer = tree.is_split((cells[rows, None] + steps).reshape(-1)).reshape(-1, 18)
    faces, across = finer[:, :6], finer[:, 6:]
    first, second = torch.tensor(_FACES_AT_EDGE, device=device).unbind(dim=1)
    edges = across | faces[:, first] | faces[:, second]
    touched = edges.any(dim=1)
    return FinerNeighbours(rows=rows[touched], edges=edges[touched], faces=faces[touched])


def _near_split_cells(tree: Octree, cells: Int64[Tensor, " n"]) -> Bool[Tensor, " n"]:
    """Whether a cell lies in or at the bounding box of its level's split cells: a cheap test that spares lookups."""
    near = torch.zeros(cells.shape[0], dtype=torch.bool, device=cells.device)
    for level, begin, end in levels_in(tree.split_cells):
        first, last = torch.searchsorted(cells, _level_bounds(level, cells.device)).tolist()
        if first < last:
            corner = unpack_ijk(tree.split_cells[begin:end])
            ijk = unpack_ijk(cells[first:last])
            low, high = corner.amin(dim=0) - 1, corner.amax(dim=0) + 1
            near[first:last] = ((ijk >= low) & (ijk <= high)).all(dim=1)
    return near


def levels_in(cells: Int64[Tensor, " n"]) -> Iterator[tuple[int, int, int]]:
    """Every level that an ascending list of keys has, with the first of its rows and the one after the last."""
    found, counts = torch.unique_consecutive(levels_of(cells), return_counts=True)
    begin = 0
    for level, count in zip(found.tolist(), counts.tolist(), strict=True):
        yield level, begin, begin + count
        begin += count


def _level_bounds(level: int, device: torch.device) -> Int64[Tensor, " 2"]:
    """The least key of a level and of the next one."""
    zero = torch.zeros(1, 3, dtype=torch.int64, device=device)
    return torch.cat([pack(level, zero), pack(level + 1, zero)])


# ------------------------------------------------------------------------------------------------------------- vertices


def vertex_level(grid: Grid) -> int:
    """The finest level at which the box of a grid has coordinates."""
    level = grid.level
    while max(grid.base_shape) << level + 1 <= MAX_CELLS_PER_AXIS:
        level += 1
    return level


def vertex_ijk(grid: Grid, vertices: Int64[Tensor, " n"]) -> Int64[Tensor, "n 3"]:
    """Coordinates, on the level of vertices, of corners of the grid or of an octree over it."""
    return unpack_ijk(vertices) << (vertex_level(grid) - levels_of(vertices))[:, None]


def corner_keys(grid: Grid, cells: Int64[Tensor, " c"]) -> Int64[Tensor, "c 8"]:
    """Vertices at the corners of the cells."""
    return _vertex_keys(grid, cells, unpack_ijk(cells), corner_offsets(cells.device), vertex_level(grid))


def lattice_keys(grid: Grid, cells: Int64[Tensor, " c"]) -> Int64[Tensor, "c 27"]:
    """Vertices at all lattice points of the cells, which must not be of the finest level there can be."""
    number = torch.arange(27, device=cells.device)
    offsets = torch.stack([number % 3, number // 3 % 3, number // 9], dim=1)
    return _vertex_keys(grid, cells, 2 * unpack_ijk(cells), offsets, vertex_level(grid) - 1)


def _vertex_keys(
    grid: Grid, cells: Int64[Tensor, " c"], ijk: Int64[Tensor, "c 3"], offsets: Int64[Tensor, "o 3"], level: int
) -> Int64[Tensor, "c o"]:
    """Vertices at ``offsets`` from ``ijk``, in units that are a cell's side where ``level`` is the cell's."""
    shift = level - levels_of(cells)
    # A key is linear in its coordinates, which spares the packing of each vertex.
    return pack(vertex_level(grid), ijk << shift[:, None])[:, None] + (pack(0, offsets) << shift[:, None])
