"""The ``flexicubes`` extractor: learnable tables round the pure functions of this package."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.extractors import Extraction, RefiningExtractor
from sculpt_framework.geometry.band import Band, levels_of
from sculpt_framework.geometry.cell_policy import CellPolicy
from sculpt_framework.geometry.grid import Grid, pack
from sculpt_framework.geometry.keys import find
from sculpt_framework.geometry.octree import corner_keys, heirs, vertex_ijk, vertex_level
from sculpt_framework.geometry.octree_band import OctreeBand
from sculpt_framework.geometry.octree_hold import HeldSurface
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.keyed import KeyedTable
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.surface import grid_surface, octree_surface

WEIGHT_SPAN = 0.99
"""Weights lie in 1 +- this: always positive, neutral at raw 0."""
SHIFT_SPAN = 0.49
"""Largest shift of a corner along an axis, in cells: below half a cell, so that cells cannot turn inside out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellWeights:
    """Raw weights of the band's cells, neutral at 0; None where nothing is learned."""

    alpha: Float[Tensor, "c 8"] | None = None
    beta: Float[Tensor, "c 12"] | None = None
    gamma: Float[Tensor, "c 1"] | None = None

    def joined(self) -> Float[Tensor, "c w"] | None:
        raw = [weight for weight in (self.alpha, self.beta, self.gamma) if weight is not None]
        return torch.cat(raw, dim=1) if raw else None

    def positive(self) -> list[Float[Tensor, "c w"] | None]:
        """The weights in use: alpha, beta, gamma."""
        raw = (self.alpha, self.beta, self.gamma)
        return [None if weight is None else 1 + WEIGHT_SPAN * torch.tanh(weight) for weight in raw]


class FlexiCubes(RefiningExtractor):
    """Dual marching cubes on the band with FlexiCubes' alpha, beta, gamma and delta, also across cells of two sizes."""

    def __init__(self, config: FlexiCubesConfig, grid: Grid, device: torch.device, dtype: torch.dtype):
        self.config = config
        self._device = device
        self._dtype = dtype
        self._tables: dict[str, KeyedTable] = {}
        self._weight_sizes = {"alpha": 8, "beta": 12} | ({"gamma": 1} if config.split == "center" else {})
        if config.learn_weights:
            self._tables["cells"] = KeyedTable(dict.fromkeys(self._weight_sizes, config.weight_rate))
        if config.learn_deformation:
            self._tables["corners"] = KeyedTable({"delta": config.deformation_rate})
        self._cells = CellPolicy(grid, tuple(self._weight_sizes) if config.learn_weights else ())
        self._corner_reach = torch.zeros(0, dtype=dtype, device=device)
        """Of each row of deltas, the side of the smallest cell at its corner."""

    @property
    def cells(self) -> CellPolicy:
        return self._cells

    @property
    def tables(self) -> dict[str, KeyedTable]:
        return {**self._tables, **self._cells.tables}

    def set_grid(self, grid: Grid) -> None:
        """Cells take over the weights, and their optimiser state, of the cells they lie in or hold.

        Shifts of corners are forgotten: the field says what the sdf is at the place they return to.
        """
        before = self.grid
        self._cells.set_grid(grid)
        if grid != before and self.config.learn_deformation:
            self._tables["corners"] = KeyedTable({"delta": self.config.deformation_rate})

    @torch.no_grad()
    def surface_to_hold(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> HeldSurface:
        band = self._follow(sdf, seeds)
        return HeldSurface(
            corners=band.corners,
            positions=band.corner_positions,
            sdf=band.corner_sdf,
            cells=band.cells,
            weights=self._cell_weights(band.cells),
            distance=sdf,
        )

    def extract(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> Extraction:
        band = self._follow(sdf, seeds)
        weights = CellWeights(**self._cell_weights(band.cells))
        split, damp = self.config.split, self.config.damp_grazing
        if isinstance(band, OctreeBand):
            found = octree_surface(band, split, *weights.positive(), damp_grazing=damp)
        else:
            found = grid_surface(band, self.grid.cell, split, *weights.positive(), damp_grazing=damp)
        return Extraction(
            surface=found.surface,
            grid=self.grid,
            cells=band.cells,
            cell_corners=band.cell_corners,
            corner_positions=band.corner_positions,
            corner_sdf=band.corner_sdf,
            edge_sdf=found.edge_sdf,
            deviation=found.deviation,
            cell_weights=weights.joined(),
        )

    def _follow(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> Band | OctreeBand:
        if self.config.learn_deformation:
            self._prepare_deformation(seeds)
        return self._cells.band(self._cells.sampler(self._corner_positions, sdf), seeds)

    def _cell_weights(self, cells: Int64[Tensor, " c"]) -> Mapping[str, Float[Tensor, "c w"]]:
        """Raw weights of the cells, by name. New ones take over from those they lie in or hold, or start neutral."""
        if not self.config.learn_weights:
            return {}
        table = self._tables["cells"]
        if not _same_keys(table.keys, cells):
            neutral = {
                name: torch.zeros(cells.shape[0], size, dtype=self._dtype, device=self._device)
                for name, size in self._weight_sizes.items()
            }
            table.rekey(cells, neutral, heirs(table.keys, cells) if len(table) > 0 else None)
        return self._cells.weights(cells, table.leaves)

    def _prepare_deformation(self, seeds: Int64[Tensor, " s"]) -> None:
        """Give every corner of the seeds, which are the cells of the last band, a row.

        Rows must exist before the sdf is sampled. A corner that only tracking reaches is sampled where the grid has it,
        and gets its row in the next extraction.
        """
        table = self._tables["corners"]
        corners, rows = torch.unique(corner_keys(self.grid, seeds), return_inverse=True)
        level = torch.zeros_like(corners).scatter_reduce(
            0, rows.reshape(-1), levels_of(seeds).repeat_interleave(8), "amax"
        )
        self._corner_reach = self.grid.base_cell * torch.pow(0.5, level.to(self._dtype))
        if not _same_keys(table.keys, corners):
            table.rekey(corners, {"delta": torch.zeros(len(corners), 3, dtype=self._dtype, device=self._device)})

    def _corner_positions(self, corners: Int64[Tensor, " m"]) -> Float[Tensor, "m 3"]:
        """Where corners, of the grid or of an octree over it, are; deltas are kept by the latter's keys."""
        finest = self.grid.at_level(vertex_level(self.grid))
        ijk = vertex_ijk(self.grid, corners)
        positions = finest.corner_positions(ijk, self._dtype)
        if not self.config.learn_deformation:
            return positions
        table = self._tables["corners"]
        row, known = find(table.keys, pack(finest.level, ijk))
        delta = torch.tanh(table.leaves["delta"].index_select(0, row))
        shift = SHIFT_SPAN * self._corner_reach.index_select(0, row)[:, None] * delta
        # Corners of the wall stay, so that the surface stays in the box.
        return positions + torch.where((known & ~finest.on_wall(ijk))[:, None], shift, 0.0)


def _same_keys(old: Int64[Tensor, " n"], new: Int64[Tensor, " m"]) -> bool:
    """Whether both are the same list. An empty table is on the CPU, wherever its rows will be."""
    return old.shape == new.shape and torch.equal(old, new)
