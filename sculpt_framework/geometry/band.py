"""The narrow band: the cells of a grid that the zero level set passes through, found without touching the volume.

Everything here is a pure function of sorted int64 keys (see ``geometry.grid``). Keys are linear in the coordinates, so
the key of a place that lies a fixed offset away is the key plus a constant.

Numbering used by all extractors. Corner n of a cell lies at offset (n & 1, n >> 1 & 1, n >> 2). Face 2a + s of a cell
is the one across axis a on its lower (s = 0) or upper (s = 1) side. The case of a cell has bit n set where corner n is
inside. Inside means sdf < 0; exactly 0 is outside.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.geometry.grid import AXIS_BITS, PART_BITS, PRIMITIVE_BITS, Grid, pack, unpack_ijk
from sculpt_framework.geometry.keys import find, merging
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction

CornerSampler = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Keys "m" of grid corners to their positions "m 3" (a deformation may have moved them) and signed distances "m"."""

WALL_SDF = 1e-2
"""Least signed distance on the wall of the grid, in cells: small, so that a surface cut off there stays close to the
wall, and well above what rounding could undo."""

LEAST_DROP = 1e-3
"""Least change of the signed distance along an edge, in cells, that interpolation divides by."""

_LEVEL_SHIFT = 3 * AXIS_BITS + PRIMITIVE_BITS + PART_BITS
FACE_CORNERS = tuple(sum(1 << n for n in range(8) if n >> a & 1 == side) for a in range(3) for side in (0, 1))
"""Corners of each face of a cell, as bits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """The cells whose corners differ in sign, and everything at their corners.

    Closed: of every grid edge and every cell face whose corners differ in sign, all the cells that share it are here.
    """

    cells: Int64[Tensor, " c"]
    """Keys of the cells, ascending."""
    cases: Int64[Tensor, " c"]
    """Which corners are inside, as bits; never 0 nor 255."""
    corners: Int64[Tensor, " n"]
    """Keys of the corners, ascending."""
    cell_corners: Int64[Tensor, "c 8"]
    """Rows of the corners of each cell."""
    cell_at_corner: Int64[Tensor, " n"]
    """Row of the cell that has this corner as its corner 0; -1 where the band has no such cell."""
    corner_positions: Float[Tensor, "n 3"]
    corner_sdf: Float[Tensor, " n"]

    def neighbour(self, cells: Int64[Tensor, "..."], offset: int | Int64[Tensor, "..."]) -> Int64[Tensor, "..."]:
        """Rows of the cells whose corner 0 is corner ``offset`` of the given rows; -1 where there is none."""
        return self.cell_at_corner[self.cell_corners[cells, offset]]

    def detach(self) -> "Band":
        """The same without gradient, to be kept."""
        return replace(self, corner_positions=self.corner_positions.detach(), corner_sdf=self.corner_sdf.detach())


def corner_offsets(device: torch.device) -> Int64[Tensor, "8 3"]:
    """Offsets of the corners of a cell from its corner 0."""
    number = torch.arange(8, device=device)
    return torch.stack([number & 1, number >> 1 & 1, number >> 2], dim=1)


def levels_of(keys: Int64[Tensor, " n"]) -> Int64[Tensor, " n"]:
    """Grid level each key belongs to."""
    return keys >> _LEVEL_SHIFT


def children(cells: Int64[Tensor, " c"]) -> Int64[Tensor, " d"]:
    """Keys of the eight cells, one level finer, that fill each of the given cells; ascending."""
    ijk = 2 * unpack_ijk(cells)[:, None] + corner_offsets(cells.device)
    level = (levels_of(cells) + 1).repeat_interleave(8)
    return ((level << _LEVEL_SHIFT) + pack(0, ijk.reshape(-1, 3))).sort().values


def parents(cells: Int64[Tensor, " c"]) -> Int64[Tensor, " c"]:
    """Key of the cell, one level coarser, that holds each cell. Cells of level 0 have none: theirs is negative."""
    return (levels_of(cells) - 1 << _LEVEL_SHIFT) + pack(0, unpack_ijk(cells) >> 1)


def cells_at_level(cells: Int64[Tensor, " c"], steps: int) -> Int64[Tensor, " d"]:
    """Keys, ascending, of the cells ``steps`` levels finer inside the given ones; of those around them, if negative."""
    for _ in range(steps):
        cells = children(cells)
    for _ in range(-steps):
        cells = parents(cells).unique()
    return cells


def coarsened(cells: Int64[Tensor, " c"], level: int) -> Int64[Tensor, " d"]:
    """Cells of finer levels replaced by those of ``level`` that hold them, each once, ascending; others stay."""
    while bool((finer := levels_of(cells) > level).any()):
        cells = torch.cat([cells[~finer], parents(cells[finer])])
    return cells.unique()


def corners_of(cells: Int64[Tensor, " c"]) -> tuple[Int64[Tensor, " n"], Int64[Tensor, "c 8"]]:
    """Keys of all corners of the cells, ascending and distinct, and the rows of each cell's eight."""
    keys = cells[:, None] + pack(0, corner_offsets(cells.device))
    corners, rows = torch.unique(keys, return_inverse=True)
    return corners, rows


def cases_of(inside: Bool[Tensor, "c 8"]) -> Int64[Tensor, " c"]:
    """The case of each cell from the signs of its corners."""
    # A row's eight bytes are one number; times this, byte n adds 2^(56 + n), and what else it adds stays below 2^56 or
    # leaves the number.
    gathered = inside.contiguous().view(torch.int64)[:, 0] * 0x0102040810204080
    return gathered >> 56 & 255


def crossing_weight(
    inner: Float[Tensor, "*shape"],
    outer: Float[Tensor, "*shape"],
    least: float | Float[Tensor, "..."],
    damped_below: float | Float[Tensor, "..."] | None = None,
) -> Float[Tensor, "*shape"]:
    """Where, from 0 to 1 along an edge, a linear function that goes from -inner to +outer is zero.

    Both arguments are non-negative. It is exact where they add up to ``least`` or more; below, it turns continuously
    towards the middle, so that its gradient never exceeds 1 / least, even where both are zero.

    With ``damped_below`` its gradient, not its value, is taken times the share of that which both add up to, if they
    add up to less: it never exceeds 1 / damped_below then.
    """
    change = inner + outer
    weight = 0.5 + 0.5 * (inner - outer) / change.clamp(min=least)
    if damped_below is None:
        return weight
    return weight.detach() + (change.detach() / damped_below).clamp(max=1.0) * (weight - weight.detach())


@torch.no_grad()
def discover(
    sdf: SdfFunction,
    grid: Grid,
    coarse_level: int,
    lipschitz: float = 1.0,
    margin: float = 0.0,
    device: torch.device | None = None,
    points_per_call: int = 1 << 18,
) -> Int64[Tensor, " s"]:
    """Keys, ascending, of the cells of ``grid`` that may hold surface: a coarse-to-fine search, without gradient.

    All cells of ``coarse_level`` are looked at; from there on only the children of those that were kept. A cell is kept
    if |sdf| at its centre is at most ``lipschitz`` * half its diagonal + ``margin`` (object units): where the sdf
    changes by no more than ``lipschitz`` per unit of length, no surface is lost. Cells at the wall of the grid with an
    inside centre are kept as well, because the surface closes there. May be empty.
    """
    if coarse_level > grid.level:
        raise ValueError(f"coarse_level {coarse_level} is finer than the grid's level {grid.level}")
    coarse = grid.at_level(coarse_level)
    ijk = torch.cartesian_prod(*(torch.arange(n, device=device) for n in coarse.shape))
    for level in range(coarse_level, grid.level + 1):
        current = grid.at_level(level)
        if level > coarse_level:
            ijk = (2 * ijk[:, None] + corner_offsets(ijk.device)).reshape(-1, 3)
        reach = lipschitz * 0.5 * 3**0.5 * current.cell + margin
        kept = []
        for part in ijk.split(points_per_call):
            value = sdf(current.corner_positions(part, torch.get_default_dtype()) + 0.5 * current.cell)
            at_wall = current.on_wall(part) | current.on_wall(part + 1)
            kept.append(part[(value.abs() <= reach) | (at_wall & (value < 0))])
        ijk = torch.cat(kept)
    return pack(grid.level, ijk).sort().values


def track(sample: CornerSampler, grid: Grid, seeds: Int64[Tensor, " s"], before: Band | None = None) -> Band:
    """Follow the surface from the ``seeds`` (cell keys of the grid's level) until the band is closed.

    Each corner is sampled exactly once, and its value, with its gradient, is also what decides its sign: signs,
    closure and vertices cannot disagree. On the wall of the grid the sdf is raised to ``WALL_SDF`` cells. What comes
    out depends on the seeds only through the components of the surface that they meet.

    ``before`` is a band found earlier. Where the seeds are its cells, neighbours are looked up only of those whose case
    has changed; the result is the same to the bit.

    Raises EmptySurfaceError where no cell reached changes sign, FloatingPointError where a sampled sdf is not finite.
    """
    if bool((levels_of(seeds) != grid.level).any()):
        raise ValueError(f"seeds belong to other levels than the grid's {grid.level}; use children() to refine them")
    steps = _neighbour_steps(seeds.device)
    masks = torch.tensor(FACE_CORNERS, device=seeds.device)
    nothing = seeds.new_empty(0)
    # Samples are numbered in the order they are taken; ``known`` are their keys, ascending, and ``sample_of`` their
    # numbers. ``found`` are the cells with a sign change, each with the samples at its corners and its case.
    known, sample_of = nothing, nothing
    inside = torch.zeros(0, dtype=torch.bool, device=seeds.device)
    positions: list[Tensor] = []
    values: list[Tensor] = []
    found: list[tuple[Tensor, Tensor, Tensor]] = []
    if before is not None and torch.equal(before.cells, seeds):
        visited, frontier, closed = nothing, seeds, before.cases
        corners, cell_corners = before.corners, before.cell_corners
    else:
        visited, frontier, closed = nothing, seeds.unique(), None
        corners, cell_corners = corners_of(frontier)
    while frontier.shape[0] > 0:
        fresh = corners[~find(known, corners)[1]] if found else corners
        if fresh.shape[0] > 0:
            position, value = sample_corners(sample, grid, fresh, WALL_SDF * grid.cell)
            positions.append(position)
            values.append(value)
            number = torch.arange(len(fresh), device=fresh.device) + len(inside)
            order = merging(known, fresh)
            known, sample_of = torch.cat([known, fresh])[order], torch.cat([sample_of, number])[order]
            inside = torch.cat([inside, value.detach() < 0])
        samples = sample_of[find(known, corners)[0]][cell_corners] if found else cell_corners
        cases = cases_of(inside[samples])
        crossed = (cases > 0) & (cases < 255)
        found.append((frontier[crossed], samples[crossed], cases[crossed]))
        visited = torch.cat([visited, frontier])[merging(visited, frontier)]
        # Every face whose corners differ in sign must have a cell on its other side; uniform cells have no such face.
        # Those of a cell that had this case in a closed band are among its cells, which have all been visited.
        if closed is not None:
            changed = cases != closed
            frontier, cases, closed = frontier[changed], cases[changed], None
        part = cases[:, None] & masks
        beyond = (frontier[:, None] + steps)[(part > 0) & (part < masks)].unique()
        frontier = beyond[~find(visited, beyond)[1]]
        corners, cell_corners = corners_of(frontier)

    if sum(len(cells) for cells, _, _ in found) == 0:
        raise EmptySurfaceError(f"the signed distance has one sign at the corners of all {len(visited)} cells tried")
    cells = torch.cat([cells for cells, _, _ in found])
    order = merging(found[0][0], cells[len(found[0][0]) :])
    cells, samples = cells[order], torch.cat([samples for _, samples, _ in found])[order]
    used = torch.zeros_like(inside)
    used[samples] = True
    kept = used[sample_of]
    corners, row = known[kept], sample_of[kept]
    rank = torch.empty_like(sample_of)
    rank[row] = torch.arange(len(row), device=row.device)
    cell_corners = rank[samples]
    cell_at_corner = torch.full_like(corners, -1)
    cell_at_corner[cell_corners[:, 0]] = torch.arange(len(cells), device=cells.device)
    return Band(
        cells=cells,
        cases=torch.cat([cases for _, _, cases in found])[order],
        corners=corners,
        cell_corners=cell_corners,
        cell_at_corner=cell_at_corner,
        corner_positions=torch.cat(positions).index_select(0, row),
        corner_sdf=torch.cat(values).index_select(0, row),
    )


def _neighbour_steps(device: torch.device) -> Int64[Tensor, " 6"]:
    """What a cell's key grows by across each of its faces."""
    along = pack(0, torch.eye(3, dtype=torch.int64, device=device))
    return torch.stack([-along, along], dim=1).reshape(-1)


def sample_corners(
    sample: CornerSampler, grid: Grid, corners: Int64[Tensor, " m"], wall_sdf: float
) -> tuple[Float[Tensor, "m 3"], Float[Tensor, " m"]]:
    """Positions and sdf of corners of ``grid``, checked to be finite; at its wall the sdf is at least ``wall_sdf``."""
    position, value = sample(corners)
    broken = ~torch.isfinite(value.detach())
    if bool(broken.any()):
        raise FloatingPointError(f"the signed distance is not finite at {int(broken.sum())} of {len(value)} corners")
    wall = grid.on_wall(unpack_ijk(corners))
    return position, torch.where(wall, value.clamp(min=wall_sdf), value)
