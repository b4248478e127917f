"""The ``flexicubes`` extractor: learnable tables round the pure functions of this package."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.extractors import Extraction, Extractor, SdfFunction
from sculpt_framework.geometry.band import corners_of, find, parents, track
from sculpt_framework.geometry.grid import PART_BITS, Grid, unpack_ijk
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.types import Surface
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.geometry import center_split, diagonal_split, dual_vertices
from sculpt_plugins.extractors.flexicubes.topology import DualTopology, dual_topology

WEIGHT_SPAN = 0.99
"""Weights lie in 1 +- this: always positive, neutral at raw 0."""
SHIFT_SPAN = 0.49
"""Largest shift of a corner along an axis, in cells: below half a cell, so that cells cannot turn inside out."""
CENTER_PRIMITIVE = 6
"""Face keys: primitive is axis + 3 * diagonal for split diagonal, this + axis for split center."""
DESCENDING_PART = 4
"""Face keys: part is the triangle's number in its quad, plus this where the upper end of the edge is inside. Such a
face turns the other way round, so it is another face."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellWeights:
    """Raw weights of the band's cells, neutral at 0; None where nothing is learned."""

    alpha: Float[Tensor, "c 8"] | None = None
    beta: Float[Tensor, "c 12"] | None = None
    gamma: Float[Tensor, "c 1"] | None = None

    def joined(self) -> Float[Tensor, "c w"] | None:
        raw = [weight for weight in (self.alpha, self.beta, self.gamma) if weight is not None]
        return torch.cat(raw, dim=1) if raw else None


class FlexiCubes(Extractor):
    """Dual marching cubes on the band with FlexiCubes' alpha, beta, gamma and delta."""

    def __init__(self, config: FlexiCubesConfig, grid: Grid, device: torch.device, dtype: torch.dtype):
        self.config = config
        self._grid = grid
        self._device = device
        self._dtype = dtype
        self._tables: dict[str, KeyedTable] = {}
        self._weight_sizes = {"alpha": 8, "beta": 12} | ({"gamma": 1} if config.split == "center" else {})
        if config.learn_weights:
            self._tables["cells"] = KeyedTable(dict.fromkeys(self._weight_sizes, config.weight_rate))
        if config.learn_deformation:
            self._tables["corners"] = KeyedTable({"delta": config.deformation_rate})

    @property
    def grid(self) -> Grid:
        return self._grid

    @property
    def tables(self) -> dict[str, KeyedTable]:
        return self._tables

    def set_grid(self, grid: Grid) -> None:
        """Cells of the new level take over the weights of the cell of the old level they lie in.

        Corners that both levels share keep no shift: the field says what the sdf is at the place they return to.
        """
        if grid.at_level(0) != self._grid.at_level(0):
            raise ValueError("set_grid changes the level of a grid, not its box")
        self._grid = grid

    def extract(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> Extraction:
        if self.config.learn_deformation:
            self._prepare_deformation(seeds)

        def sample(corners: Tensor) -> tuple[Tensor, Tensor]:
            positions = self._corner_positions(corners)
            return positions, sdf(positions)

        band = track(sample, self._grid, seeds)
        weights = self._cell_weights(band.cells)
        topology = dual_topology(band)
        vertices, deviation = dual_vertices(
            topology,
            band.corner_positions,
            band.corner_sdf,
            self._grid.cell,
            alpha=_positive(weights.alpha),
            beta=_positive(weights.beta),
        )
        return Extraction(
            surface=self._triangulate(topology, vertices, _positive(weights.gamma)),
            grid=self._grid,
            cells=band.cells,
            cell_corners=band.cell_corners,
            corner_positions=band.corner_positions,
            corner_sdf=band.corner_sdf,
            edge_sdf=band.corner_sdf.index_select(0, topology.ends.reshape(-1)).reshape(-1, 2),
            deviation=deviation,
            cell_weights=weights.joined(),
        )

    def _triangulate(
        self, topology: DualTopology, vertices: Float[Tensor, "d 3"], gamma: Float[Tensor, "c 1"] | None
    ) -> Surface:
        if self.config.split == "diagonal":
            triangles, second = diagonal_split(vertices, topology.vertices)
            primitive = topology.axis + 3 * second.long()
        else:
            quad_gamma = (
                None if gamma is None else gamma[:, 0].index_select(0, topology.cells.reshape(-1)).reshape(-1, 4)
            )
            triangles, centers = center_split(vertices, topology.vertices, quad_gamma)
            vertices = torch.cat([vertices, centers])
            primitive = topology.axis + CENTER_PRIMITIVE
        part = torch.arange(triangles.shape[1], device=triangles.device)
        quad_keys = topology.keys + (primitive << PART_BITS) + DESCENDING_PART * topology.descending
        return Surface(
            vertices=vertices, faces=triangles.reshape(-1, 3), face_keys=(quad_keys[:, None] + part).reshape(-1)
        )

    def _cell_weights(self, cells: Int64[Tensor, " c"]) -> CellWeights:
        """Raw weights of the cells. New ones inherit from the nearest coarser cell that has some, or start neutral."""
        if not self.config.learn_weights:
            return CellWeights()
        table = self._tables["cells"]
        if not _same_keys(table.keys, cells):
            table.rekey(cells, self._inherited(table, cells))
        return CellWeights(**table.leaves)

    def _inherited(self, table: KeyedTable, cells: Int64[Tensor, " c"]) -> dict[str, Tensor]:
        """Rows for the cells; what is said of those the table has already is not used."""
        rows = {
            name: torch.zeros(cells.shape[0], size, dtype=self._dtype, device=self._device)
            for name, size in self._weight_sizes.items()
        }
        heirs = torch.nonzero(~table.locate(cells)[1]).squeeze(1)
        ancestors = cells[heirs]
        for _ in range(self._grid.level):
            ancestors = parents(ancestors)
            row, known = table.locate(ancestors)
            for name, leaf in table.leaves.items():
                rows[name][heirs[known]] = leaf.detach()[row[known]]
            heirs, ancestors = heirs[~known], ancestors[~known]
        return rows

    def _prepare_deformation(self, seeds: Int64[Tensor, " s"]) -> None:
        """Give every corner of the seeds, which are the cells of the last band, a row.

        Rows must exist before the sdf is sampled. A corner that only tracking reaches is sampled where the grid has it,
        and gets its row in the next extraction.
        """
        table = self._tables["corners"]
        corners = corners_of(seeds)[0].unique()
        if not _same_keys(table.keys, corners):
            table.rekey(corners, {"delta": torch.zeros(len(corners), 3, dtype=self._dtype, device=self._device)})

    def _corner_positions(self, corners: Int64[Tensor, " m"]) -> Float[Tensor, "m 3"]:
        ijk = unpack_ijk(corners)
        positions = self._grid.corner_positions(ijk, self._dtype)
        if not self.config.learn_deformation:
            return positions
        table = self._tables["corners"]
        row, known = find(table.keys, corners)
        shift = SHIFT_SPAN * self._grid.cell * torch.tanh(table.leaves["delta"].index_select(0, row))
        # Corners of the wall stay, so that the surface stays in the box.
        return positions + torch.where((known & ~self._grid.on_wall(ijk))[:, None], shift, 0.0)


def _same_keys(old: Int64[Tensor, " n"], new: Int64[Tensor, " m"]) -> bool:
    """Whether both are the same list. An empty table is on the CPU, wherever its rows will be."""
    return old.shape == new.shape and torch.equal(old, new)


def _positive(raw: Float[Tensor, "c w"] | None) -> Float[Tensor, "c w"] | None:
    return None if raw is None else 1 + WEIGHT_SPAN * torch.tanh(raw)
