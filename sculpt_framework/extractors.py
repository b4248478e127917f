"""Slot ``extractor``: from signed distance to a closed triangle mesh, differentiably."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.geometry.cell_policy import CellPolicy
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.octree_hold import HeldSurface
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.types import Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Extraction:
    """A surface and what regularisers need to know of how it came about.

    The band is the set of grid cells the surface passes through: all of the grid's level, or, where an extractor
    refines in boxes or spares cells, of several levels. Its sdf values carry gradient.
    """

    surface: Surface
    grid: Grid
    cells: Int64[Tensor, " c"]
    """Keys of the band's cells, ascending."""
    cell_corners: Int64[Tensor, "c 8"]
    """Rows of ``corner_positions`` and ``corner_sdf``; corner n of a cell is at offset (n & 1, n >> 1 & 1, n >> 2)."""
    corner_positions: Float[Tensor, "n 3"]
    corner_sdf: Float[Tensor, " n"]
    edge_sdf: Float[Tensor, "e 2"]
    """Signed distance at the inner and outer end of every grid edge the surface crosses, once per edge."""
    deviation: Float[Tensor, " d"]
    """FlexiCubes' L_dev terms, one per dual vertex; empty for extractors without dual vertices."""
    cell_weights: Float[Tensor, "c w"] | None
    """FlexiCubes' raw alpha, beta and gamma of the band's cells, for the weight regulariser; None if there are none."""


class Extractor(ABC):
    """Extracts the zero level set on a narrow band of grid cells.

    Contract (checked for every registered extractor): whenever the level set lies inside the grid the mesh is closed,
    edge- and vertex-manifold, outward-oriented and without repeated faces; face keys are distinct and stable; memory
    and time follow the band, never the volume; vertices are differentiable in the sdf values and in the tables.
    """

    @property
    @abstractmethod
    def grid(self) -> Grid: ...

    @abstractmethod
    def set_grid(self, grid: Grid) -> None:
        """Work on another level of the same grid from now on; learned parameters are carried over."""

    @property
    @abstractmethod
    def tables(self) -> dict[str, KeyedTable]:
        """Learnable parameters by name, by keys of cells or corners of the grid or an octree over it; empty if none."""

    @abstractmethod
    def extract(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> Extraction:
        """The surface component(s) that pass through the ``seeds`` (cell keys; cells without surface are allowed).

        Follows the surface from the seeds until it is closed: cells the seeds missed are added. At the wall of the grid
        the sdf is raised to a small positive value, so that the surface closes inside.

        Raises EmptySurfaceError if no seed cell, nor any cell reached from one, changes sign.
        """


class RefiningExtractor(Extractor):
    """An extractor that can work on finer cells in boxes and on coarser ones elsewhere, to the same contract.

    The cells of an extraction, and its seeds, then are of several levels: those that ``cells`` says.
    """

    @property
    @abstractmethod
    def cells(self) -> CellPolicy:
        """What to tell of boxes, worth and holding; it has the grid, and finds the band."""

    @property
    def grid(self) -> Grid:
        return self.cells.grid

    @abstractmethod
    def surface_to_hold(self, sdf: SdfFunction, seeds: Int64[Tensor, " s"]) -> HeldSurface:
        """The surface that ``extract`` makes of this now, as ``CellPolicy.hold_outside`` takes it."""
