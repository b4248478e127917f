"""Which dual vertices a leaf of an octree has, and which of them each crossing on its boundary belongs to."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sculpt_framework.geometry.band import levels_of
from sculpt_framework.geometry.grid import PART_BITS, pack, unpack_ijk
from sculpt_framework.geometry.octree import FACE_POINTS, along
from sculpt_framework.geometry.octree_band import OctreeBand
from sculpt_plugins.extractors.flexicubes.octree_cycles import SLOTS, SQUARES, Cycles, cycles
from sculpt_plugins.extractors.flexicubes.tables import dual_tables


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """The patches, or cycles, of all leaves of a band; the dual vertices are counted leaf by leaf."""

    vertex_count: int
    _first_entry: Int64[Tensor, " c"]
    _entries: Int64[Tensor, " n"]

    def vertices(self, cells: Int64[Tensor, "*shape"], slots: Int64[Tensor, "*shape"]) -> Int64[Tensor, "*shape"]:
        """Dual vertices of leaves at crossed slots."""
        return self._entries[self._first_entry[cells] + slots]


def patches_of(band: OctreeBand) -> Patches:
    """Looked up by case, but for the leaves with smaller ones at a face; with troubled squares flipped."""
    tables = dual_tables(band.cells.device)
    divided = torch.nonzero((band.lattice[:, FACE_POINTS] >= 0).any(dim=1)).squeeze(1)
    special, lattice = band.uneven[divided], band.lattice[divided]
    vertices = lattice >= 0
    inside = vertices & (band.corner_sdf.detach() < 0)[lattice]
    inverted, found = _untroubled(band, special, inside, vertices)

    patch = tables.patch[inverted.long(), band.cases]
    count = tables.patch_count[inverted.long(), band.cases]
    count[special] = found.count
    first_vertex = count.cumsum(0) - count
    first_entry = 12 * torch.arange(len(count), device=count.device)
    first_entry[special] = 12 * len(count) + SLOTS * torch.arange(len(special), device=count.device)
    own = [first_vertex[:, None] + patch, first_vertex[special, None] + found.patch]
    return Patches(
        vertex_count=int(count.sum()),
        _first_entry=first_entry,
        _entries=torch.cat([entries.reshape(-1) for entries in own]),
    )


def _untroubled(
    band: OctreeBand, special: Int64[Tensor, " t"], inside: Bool[Tensor, "t 27"], vertices: Bool[Tensor, "t 27"]
) -> tuple[Bool[Tensor, " c"], Cycles]:
    """Which plain leaves use the inverted table, and the cycles of the special ones, with all squares flipped that are
    troubled for both their leaves."""
    device = band.cells.device
    troubled_face = dual_tables(device).troubled_face[band.cases]
    troubled_face[special] = -1
    inverted = torch.zeros_like(troubled_face, dtype=torch.bool)
    flipped = torch.zeros(len(special), SQUARES, dtype=torch.bool, device=device)
    found = cycles(inside, vertices, flipped)

    plain = torch.nonzero(troubled_face >= 0).squeeze(1)
    row, square = torch.nonzero(found.troubled, as_tuple=True)
    names, order = _square_names(
        band.cells[torch.cat([plain, special[row]])], torch.cat([troubled_face[plain], square])
    ).sort()
    twice = torch.zeros_like(names, dtype=torch.bool)
    twice[1:] = names[1:] == names[:-1]
    twice[:-1] |= twice[1:].clone()
    chosen = order[twice]
    inverted[plain[chosen[chosen < len(plain)]]] = True
    chosen = chosen[chosen >= len(plain)] - len(plain)
    if chosen.shape[0] > 0:
        flipped[row[chosen], square[chosen]] = True
        found = cycles(inside, vertices, flipped)
    return inverted, found


def _square_names(cells: Int64[Tensor, " k"], squares: Int64[Tensor, " k"]) -> Int64[Tensor, " k"]:
    """A name that both leaves at a square give it: the cell of its size above it, and its axis."""
    places = [along(face // 2, face % 2, 0, 0) for face in range(6)]
    # A quarter's own cell above it: twice the leaf's place, or the next, and on from there across the face.
    places += [along(face // 2, 2 * (face % 2), p, q) for face in range(6) for q in (0, 1) for p in (0, 1)]
    axes = [face // 2 for face in range(6)] + [quarter // 8 for quarter in range(24)]
    quarter = (squares >= 6).long()
    ijk = (unpack_ijk(cells) << quarter[:, None]) + torch.tensor(places, device=cells.device)[squares]
    axis = torch.tensor(axes, device=cells.device)[squares]
    return pack(levels_of(cells) + quarter, ijk) + (axis << PART_BITS)
