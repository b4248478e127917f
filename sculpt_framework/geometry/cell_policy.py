"""Which cells an extractor works on, for extractors that compose it: one grid, finer boxes, coarser places, a hold."""

from collections.abc import Callable, Mapping, Sequence

from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.geometry.band import Band, CornerSampler, track
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.octree_band import OctreeBand, grow_octree
from sculpt_framework.geometry.octree_hold import HeldSurface, Hold
from sculpt_framework.geometry.octree_policy import LevelMap, RefineBox, coarsen, roots_under, wanted_levels
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.types import Box


class CellPolicy:
    """Says which cells a surface is extracted on, and finds its band among them."""

    def __init__(self, grid: Grid, weight_names: Sequence[str] = ()):
        """``weight_names`` are what a cell's part of the surface depends on besides its corners."""
        self._grid = grid
        self._weight_names = tuple(weight_names)
        self._boxes: tuple[RefineBox, ...] = ()
        self._worth: LevelMap | None = None
        self._hold: Hold | None = None
        self._before: Band | None = None
        """The latest plain band, from which the next is found sooner."""

    @property
    def grid(self) -> Grid:
        return self._grid

    @property
    def tables(self) -> dict[str, KeyedTable]:
        """What is held, by name: rows that never learn. Empty if nothing is."""
        return {} if self._hold is None else self._hold.tables

    def set_grid(self, grid: Grid) -> None:
        """Work on another level of the same grid from now on.

        Raises ValueError for another box or, if a surface is held, another level.
        """
        if grid.at_level(0) != self._grid.at_level(0):
            raise ValueError("set_grid changes the level of a grid, not its box")
        if self._hold is not None and grid != self._grid:
            raise ValueError("the grid of a surface that is held stays what it is")
        wanted_levels(grid, self._boxes)
        self._grid = grid

    def set_boxes(self, boxes: Sequence[RefineBox]) -> None:
        """From now on refine the surface in these boxes (object frame) and nowhere else.

        Raises ValueError if cells that fine have no coordinates (``octree.vertex_level``), also later in ``set_grid``.
        """
        wanted_levels(self._grid, boxes)
        self._boxes = tuple(boxes)

    def set_worth(self, worth: LevelMap | None) -> None:
        """From now on use larger cells than the grid's where these say that smaller ones are not worth while.

        Boxes refine there all the same. None: all cells outside boxes are of the grid's size.
        """
        self._worth = worth

    def hold_outside(self, boxes: Sequence[Box], surface: HeldSurface | None = None) -> None:
        """Keep this surface outside these boxes (object frame) to the bit, whatever the sdf becomes.

        It is what the extractor makes now, so before ``set_boxes`` adds boxes to refine in, and is kept on ``tables``;
        without it they are left empty, for those of an earlier run to be loaded. Free are the grid's cells that a box
        reaches into; beyond them only a ring of cells for each level that a box refines by changes.
        """
        hold = Hold(roots_under(self._grid, self._worth), boxes, self._weight_names)
        if surface is not None:
            hold.fill(surface)
        self._hold = hold

    def sampler(self, places: Callable[[Tensor], Tensor], sdf: SdfFunction) -> CornerSampler:
        """Samples of the sdf, or of what is held, at vertices of the grid or of an octree over it.

        ``places`` takes keys of vertices ("n") to where they are ("n 3", ``octree.vertex_ijk``).
        """

        def sample(vertices: Tensor) -> tuple[Tensor, Tensor]:
            positions = places(vertices)
            return positions, sdf(positions)

        return sample if self._hold is None else self._hold.sampler(sample)

    def band(self, sample: CornerSampler, seeds: Int64[Tensor, " s"]) -> Band | OctreeBand:
        """The band of the surface, from samples of ``sampler``: plain where all cells are alike.

        Raises as ``band.track`` and ``octree_band.grow_octree``.
        """
        roots = roots_under(self._grid, self._worth)
        wanted = wanted_levels(self._grid, self._boxes, self._worth)
        if self._hold is not None:
            return grow_octree(sample, roots, self._hold.seeds(seeds, wanted), wanted)
        if self._boxes or self._worth is not None:
            return grow_octree(sample, roots, coarsen(roots, seeds, wanted), wanted)
        band = track(sample, self._grid, seeds, self._before)
        self._before = band.detach()
        return band

    def weights(
        self, cells: Int64[Tensor, " c"], live: Mapping[str, Float[Tensor, "c w"]]
    ) -> Mapping[str, Float[Tensor, "c w"]]:
        """Weights of cells, by name: what is held where something is, ``live`` ones elsewhere."""
        return live if self._hold is None else self._hold.weights(cells, live)
