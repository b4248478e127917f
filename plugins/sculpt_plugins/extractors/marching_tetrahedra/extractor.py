"""The ``marching-tetrahedra`` extractor."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.extractors import Extraction, RefiningExtractor
from sculpt_framework.geometry.band import LEAST_DROP, Band, CornerSampler, crossing_weight
from sculpt_framework.geometry.cell_policy import CellPolicy
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.octree import vertex_ijk, vertex_level
from sculpt_framework.geometry.octree_band import OctreeBand
from sculpt_framework.geometry.octree_hold import HeldSurface
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.types import Surface
from sculpt_plugins.extractors.marching_tetrahedra.octree import edge_lengths, march, split_leaves, with_centers
from sculpt_plugins.extractors.marching_tetrahedra.tables import tetrahedra_tables


class MarchingTetrahedra(RefiningExtractor):
    """Linear interpolation in six tetrahedra per cell of the band; a vertex on every tetrahedron edge that crosses.

    The low 7 bits of a face key name the triangle within its cell: tetrahedron, signs of its corners, first or second.
    Cells that smaller ones touch have more tetrahedra (``octree``).
    """

    def __init__(self, grid: Grid, dtype: torch.dtype):
        self._cells = CellPolicy(grid)
        self._dtype = dtype

    @property
    def cells(self) -> CellPolicy:
        return self._cells

    @property
    def tables(self) -> dict[str, KeyedTable]:
        return self._cells.tables

    def set_grid(self, grid: Grid) -> None:
        self._cells.set_grid(grid)

    @torch.no_grad()
    def surface_to_hold(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> HeldSurface:
        sample = self._cells.sampler(self._places, sdf)
        band = self._cells.band(sample, seeds)
        corners, positions, values = band.corners, band.corner_positions, band.corner_sdf
        if isinstance(band, OctreeBand):
            corners, positions, values = with_centers(band, sample)
        return HeldSurface(corners=corners, positions=positions, sdf=values, cells=band.cells, weights={}, distance=sdf)

    def extract(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> Extraction:
        sample = self._cells.sampler(self._places, sdf)
        band = self._cells.band(sample, seeds)
        return self._of_octree(band, sample) if isinstance(band, OctreeBand) else self._of_grid(band)

    def _places(self, vertices: Int64[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        finest = self.grid.at_level(vertex_level(self.grid))
        return finest.corner_positions(vertex_ijk(self.grid, vertices), self._dtype)

    def _of_octree(self, band: OctreeBand, sample: CornerSampler) -> Extraction:
        keys, positions, values = with_centers(band, sample)
        inside = values.detach() < 0
        cut = march(band, split_leaves(band, inside), inside)
        flat = cut.ends.reshape(-1)
        edge_sdf = values.index_select(0, flat).reshape(-1, 2)
        edge_positions = positions.index_select(0, flat).reshape(-1, 2, 3)
        vertices = edge_crossings(edge_positions, edge_sdf, edge_lengths(keys, cut.ends, band))
        return Extraction(
            surface=Surface(vertices=vertices, faces=cut.faces, face_keys=cut.face_keys),
            grid=self.grid,
            cells=band.cells,
            cell_corners=band.cell_corners,
            corner_positions=positions,
            corner_sdf=values,
            edge_sdf=edge_sdf,
            deviation=vertices.new_zeros(0),
            cell_weights=None,
        )

    def _of_grid(self, band: Band) -> Extraction:
        ends, vertex_of_edge = crossed_edges(band)
        flat = ends.reshape(-1)
        edge_sdf = band.corner_sdf.index_select(0, flat).reshape(-1, 2)
        edge_positions = band.corner_positions.index_select(0, flat).reshape(-1, 2, 3)
        faces, face_keys = triangles(band, vertex_of_edge)
        vertices = edge_crossings(edge_positions, edge_sdf, self.grid.cell)
        return Extraction(
            surface=Surface(vertices=vertices, faces=faces, face_keys=face_keys),
            grid=self.grid,
            cells=band.cells,
            cell_corners=band.cell_corners,
            corner_positions=band.corner_positions,
            corner_sdf=band.corner_sdf,
            edge_sdf=edge_sdf,
            deviation=vertices.new_zeros(0),
            cell_weights=None,
        )


def crossed_edges(band: Band) -> tuple[Int64[Tensor, "v 2"], Int64[Tensor, "c 7"]]:
    """Corner rows at the inner and outer end of each crossed edge, and which of them go up from corner 0 of each cell.

    Each edge is listed by the cell whose corner 0 is its lower end, in column direction - 1; -1 if it is not crossed.
    """
    inside = band.cases[:, None] >> torch.arange(8, device=band.cases.device) & 1
    crossed = inside[:, 1:] != inside[:, :1]
    number = (crossed.reshape(-1).cumsum(0) - 1).reshape(-1, 7)
    cell, direction = torch.nonzero(crossed, as_tuple=True)
    ends = torch.stack([band.cell_corners[cell, 0], band.cell_corners[cell, direction + 1]], dim=1)
    rising = inside[cell, :1] == 1
    return torch.where(rising, ends, ends.flip(1)), torch.where(crossed, number, -1)


def edge_crossings(
    positions: Float[Tensor, "v 2 3"], sdf: Float[Tensor, "v 2"], cell: float | Float[Tensor, " v"]
) -> Float[Tensor, "v 3"]:
    """Zeros of the linear interpolants between the inner (first) and outer ends of edges of cells of side ``cell``."""
    weight = crossing_weight(sdf[:, 0].abs(), sdf[:, 1].abs(), LEAST_DROP * cell)
    return torch.lerp(positions[:, 0], positions[:, 1], weight[:, None])


def triangles(band: Band, vertex_of_edge: Int64[Tensor, "c 7"]) -> tuple[Int64[Tensor, "f 3"], Int64[Tensor, " f"]]:
    """Faces as rows of vertices, and their keys."""
    tables = tetrahedra_tables(band.cells.device)
    count = tables.count[band.cases]
    cell = torch.repeat_interleave(count)
    skipped = (count.cumsum(0) - count - tables.first[band.cases])[cell]
    row = torch.arange(cell.shape[0], device=cell.device) - skipped
    owner = band.neighbour(cell[:, None], tables.edge_corner[row])
    faces = vertex_of_edge[owner, tables.edge_direction[row] - 1]
    return faces, band.cells[cell] + tables.code[row]
