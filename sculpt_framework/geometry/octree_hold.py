"""A surface held outside boxes: it stays what it was, to the bit, while the field and the cells inside change.

The cells of the grid that a box reaches into are *free*. Vertices within the free cells are sampled as ever; all others
have a value and a place that are stored once, so nothing the field does moves them. Cells that touch a free cell take
over its new vertices; every cell beyond sees what it saw before.

On the rim, the surface of the free cells, and in cells outside that are split for the sake of balance, there come to be
vertices that had no value. They are interpolated from the corners of the smallest cell that had. So no crossing can be
hidden there, which would ask for more splitting outside. Where the rim is away from the surface, its vertices have the
sign of what is stored beside them, so that the surface, which may move freely inside, cannot leave but where it did.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import CornerSampler, corner_offsets, levels_of
from sculpt_framework.geometry.grid import Grid, pack, unpack_ijk
from sculpt_framework.geometry.keys import find
from sculpt_framework.geometry.octree import WantedLevels, key_steps, vertex_ijk, vertex_level
from sculpt_framework.geometry.octree_policy import coarsen, reached_along
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.types import Box

CORNERS, CELLS = "held_corners", "held_cells"
"""Names of the tables."""
_STEPS = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldSurface:
    """What is to be held: a surface as an extractor saw it. Vertices and cells may be of the free cells as well."""

    corners: Int64[Tensor, " n"]
    """Keys of the band's vertices, of the grid or of an octree over it, distinct."""
    positions: Float[Tensor, "n 3"]
    sdf: Float[Tensor, " n"]
    cells: Int64[Tensor, " c"]
    """Keys of the band's cells, ascending."""
    weights: Mapping[str, Float[Tensor, "c w"]]
    """What else each cell's part of the surface depends on, by name."""
    distance: SdfFunction
    """Tells how far from the surface, on no matter which side, other places are."""


class Hold:
    """Holds a surface outside boxes. What is held are rows of tables that never learn, so it is saved like all rows."""

    def __init__(self, grid: Grid, boxes: Sequence[Box], weight_names: Sequence[str] = ()):
        """Holds nothing yet: ``fill`` it, or load the tables. ``grid`` is that of the roots, and stays."""
        self.grid = grid
        self._finest = grid.at_level(vertex_level(grid))
        self._reached = [reached_along(grid, box) for box in boxes]
        self.tables = {
            CORNERS: KeyedTable({"position": 0.0, "sdf": 0.0}),
            CELLS: KeyedTable(dict.fromkeys(weight_names, 0.0)),
        }

    @torch.no_grad()
    def fill(self, held: HeldSurface) -> None:
        """Hold this surface."""
        finest = self._finest
        corners = pack(finest.level, vertex_ijk(self.grid, held.corners))
        corners, order = corners.sort()
        self._store(corners, held.positions[order], held.sdf[order])
        level = int(levels_of(held.cells).max())
        rim = self._rim(level, held.cells.device)
        position, value, known = self._stored(rim)
        places = finest.corner_positions(unpack_ijk(rim), held.positions.dtype)
        distances = held.distance(places)
        distance = distances.to(value).abs().clamp(min=1e-3 * self.grid.cell)
        sides = self._spread(rim, level, torch.where(value < 0, -1, 1), known, distances)
        value = torch.where(known, value, distance * sides)
        position = torch.where(known[:, None], position, places)
        fresh = ~find(corners, rim)[1]
        every, order = torch.cat([corners, rim[fresh]]).sort()
        table = self.tables[CORNERS]
        self._store(
            every,
            torch.cat([table.leaves["position"], position[fresh]])[order],
            torch.cat([table.leaves["sdf"], value[fresh]])[order],
        )
        outside = ~self.is_free(held.cells)
        rows = {name: value.detach()[outside] for name, value in held.weights.items()}
        self.tables[CELLS].rekey(held.cells[outside], rows)

    def is_free(self, cells: Int64[Tensor, " n"]) -> Bool[Tensor, " n"]:
        """Whether cells, of the grid's level or finer, lie in free ones."""
        return self._free(unpack_ijk(cells) >> (levels_of(cells) - self.grid.level)[:, None])

    def sampler(self, sample: CornerSampler) -> CornerSampler:
        """``sample`` for vertices within the free cells, and what is held for all others."""

        def held(vertices: Tensor) -> tuple[Tensor, Tensor]:
            free = self._within(vertices)
            if bool(free.all()):
                return sample(vertices)
            held_position, held_value, known = self._stored(vertices[~free])
            if not bool(known.all()):
                raise ValueError(f"{int((~known).sum())} vertices outside the boxes lie away from what is held there")
            if not bool(free.any()):
                return held_position, held_value
            position, value = sample(vertices[free])
            rows = torch.cat([torch.nonzero(free), torch.nonzero(~free)]).squeeze(1).argsort()
            position = torch.cat([position, held_position.to(position)]).index_select(0, rows)
            return position, torch.cat([value, held_value.to(value)]).index_select(0, rows)

        return held

    def seeds(self, seeds: Int64[Tensor, " s"], wanted: WantedLevels) -> Int64[Tensor, " m"]:
        """The cells held, as they are, and of the seeds those that are free, coarsened to what is wanted."""
        return torch.cat([self.tables[CELLS].keys, coarsen(self.grid, seeds[self.is_free(seeds)], wanted)]).unique()

    def weights(self, cells: Int64[Tensor, " c"], live: Mapping[str, Tensor]) -> dict[str, Float[Tensor, "c w"]]:
        """Weights of cells: what is held where something is, ``live`` ones elsewhere."""
        table = self.tables[CELLS]
        row, there = find(table.keys, cells)
        return {
            name: torch.where(there[:, None], table.leaves[name].index_select(0, row), value) if len(table) else value
            for name, value in live.items()
        }

    # -- what is free --------------------------------------------------------------------------------------------

    def _free(self, places: Int64[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
        """Whether a box reaches into these cells of the grid; a place beyond the wall stands for the cell at it."""
        top = torch.tensor(self.grid.shape, device=places.device) - 1
        inner = places.clamp(min=0).minimum(top)
        free = torch.zeros(len(places), dtype=torch.bool, device=places.device)
        for reached in self._reached:
            free |= torch.stack([reached[a].to(places.device)[inner[:, a]] for a in range(3)]).all(dim=0)
        return free

    def _within(self, vertices: Int64[Tensor, " n"]) -> Bool[Tensor, " n"]:
        """Whether all cells of the grid at these vertices are free."""
        shift = self._finest.level - self.grid.level
        above = unpack_ijk(vertices)
        cells = torch.stack([above - 1 >> shift, above >> shift])
        offsets = corner_offsets(vertices.device)
        axes = torch.arange(3, device=vertices.device)
        within = torch.ones(len(vertices), dtype=torch.bool, device=vertices.device)
        for offset in offsets:
            within &= self._free(cells[offset, :, axes].T)
        return within

    def _rim(self, level: int, device: torch.device) -> Int64[Tensor, " n"]:
        """All corners of cells of this level on the surface of the free cells but for the wall of the grid."""
        shift, finer = self._finest.level - level, level - self.grid.level
        parts = []
        for reached in self._reached:
            spans = []
            for along in reached:
                inside = torch.nonzero(along)
                spans.append((int(inside.min()) << finer, int(inside.max()) + 1 << finer))
            for axis in range(3):
                ranges = [torch.arange(low, high + 1, device=device) for low, high in spans]
                ranges[axis] = torch.tensor(spans[axis], device=device)
                parts.append(torch.cartesian_prod(*ranges))
        rim = pack(self._finest.level, torch.cat(parts) << shift).unique()
        return rim[~self._within(rim)]

    # -- what is held --------------------------------------------------------------------------------------------

    def _store(self, keys: Int64[Tensor, " n"], positions: Float[Tensor, "n 3"], sdf: Float[Tensor, " n"]) -> None:
        table = KeyedTable({"position": 0.0, "sdf": 0.0})
        table.rekey(keys, {"position": positions, "sdf": sdf})
        self.tables[CORNERS] = table

    def _stored(
        self, vertices: Int64[Tensor, " n"]
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"], Bool[Tensor, " n"]]:
        """Positions and sdf, stored or interpolated in the smallest cell whose corners are, and which have any."""
        table = self.tables[CORNERS]
        positions, values = table.leaves["position"], table.leaves["sdf"]
        row, known = find(table.keys, vertices)
        position, value = positions[row], values[row]
        offsets = corner_offsets(vertices.device)
        for level in range(self._finest.level - 1, self.grid.level - 1, -1):
            rest = torch.nonzero(~known).squeeze(1)
            if rest.shape[0] == 0:
                break
            shift = self._finest.level - level
            ijk = unpack_ijk(vertices[rest])
            low = ijk >> shift
            part = (ijk - (low << shift)).double()[:, None] / (1 << shift)
            share = torch.where(offsets == 1, part, 1 - part).prod(dim=2)
            keys = pack(self._finest.level, ((low[:, None] + offsets) << shift).reshape(-1, 3)).reshape(-1, 8)
            row, there = find(table.keys, keys)
            there = (there | (share == 0)).all(dim=1)
            share, row, rest = share[there], row[there], rest[there]
            position[rest] = (share[..., None] * positions[row]).sum(dim=1).to(position)
            value[rest] = (share * values[row]).sum(dim=1).to(value)
            known[rest] = True
        return position, value, known

    def _spread(
        self,
        rim: Int64[Tensor, " n"],
        level: int,
        sides: Int64[Tensor, " n"],
        known: Bool[Tensor, " n"],
        sdf: Float[Tensor, " n"],
    ) -> Int64[Tensor, " n"]:
        """Which side of the surface, -1 or 1, each place of the rim is on.

        No edge with an end that was not sampled is crossed, so sides spread along edges. Where they cannot, because the
        surface crosses no part of the rim there, it is as the ``sdf`` says of most.
        """
        sides, known = sides.clone(), known.clone()
        sides[~known] = 0
        steps = key_steps(_STEPS, rim.device) << (self._finest.level - level)
        row, there = find(rim, rim[:, None] + steps)
        front = torch.nonzero(~known).squeeze(1)
        while front.shape[0] > 0:
            around = torch.where(there[front], sides[row[front]], 0).sum(dim=1).sign()
            if not bool((around != 0).any()):
                sides[front] = -1 if float(sdf[front].sum()) < 0 else 1
                break
            sides[front] = around
            front = front[around == 0]
        return sides
