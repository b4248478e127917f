"""A regular grid of cubic cells over the object's box, at one level of a dyadic ladder, and integer names of its parts.

Level L of a ladder has cells of half the size of level L - 1; corner (i, j, k) of level L is corner (2i, 2j, 2k) of
level L + 1. Nothing here has the size of the volume: cells and corners are named by keys that pack their coordinates.

A key is ``level (5 bits) | i (16) | j (16) | k (16) | primitive (4) | part (3)``, 60 bits of an int64, so that cells,
corners, edges and faces of all levels can be told apart, sorted and matched across iterations. ``primitive`` and
``part`` are 0 for cells and corners; an extractor uses them to name the faces it makes in a cell or on an edge.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

PRIMITIVE_BITS, PART_BITS, AXIS_BITS = 4, 3, 16
_PART = PRIMITIVE_BITS + PART_BITS
MAX_CELLS_PER_AXIS = (1 << AXIS_BITS) - 2


def pack(
    level: Int64[Tensor, " n"] | int,
    ijk: Int64[Tensor, "n 3"],
    primitive: Int64[Tensor, " n"] | int = 0,
    part: Int64[Tensor, " n"] | int = 0,
) -> Int64[Tensor, " n"]:
    """Keys of grid places; sorting them sorts by level, then i, j, k, primitive, part."""
    i, j, k = ijk.unbind(1)
    place = ((level << AXIS_BITS | i) << AXIS_BITS | j) << AXIS_BITS | k
    return (place << PRIMITIVE_BITS | primitive) << PART_BITS | part


def unpack_ijk(keys: Int64[Tensor, " n"]) -> Int64[Tensor, "n 3"]:
    """Coordinates of keys, whatever their level, primitive and part."""
    mask = (1 << AXIS_BITS) - 1
    place = keys >> _PART
    return torch.stack([place >> 2 * AXIS_BITS & mask, place >> AXIS_BITS & mask, place & mask], dim=1)


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Cells from ``origin``, which is the corner (0, 0, 0), in object units."""

    origin: tuple[float, float, float]
    base_shape: tuple[int, int, int]
    """Cells along x, y, z at level 0."""
    base_cell: float
    """Side of a cell at level 0."""
    level: int = 0

    def __post_init__(self) -> None:
        if max(self.shape) > MAX_CELLS_PER_AXIS:
            raise ValueError(f"grid {self.shape} exceeds {MAX_CELLS_PER_AXIS} cells along an axis")

    @property
    def shape(self) -> tuple[int, int, int]:
        x, y, z = (n << self.level for n in self.base_shape)
        return x, y, z

    @property
    def cell(self) -> float:
        return self.base_cell / (1 << self.level)

    def at_level(self, level: int) -> "Grid":
        return replace(self, level=level)

    def corner_keys(self, ijk: Int64[Tensor, "n 3"]) -> Int64[Tensor, " n"]:
        return pack(self.level, ijk)

    def corner_positions(self, ijk: Int64[Tensor, "n 3"], dtype: torch.dtype) -> Float[Tensor, "n 3"]:
        """Positions of corners in the object frame."""
        origin = torch.tensor(self.origin, dtype=dtype, device=ijk.device)
        return origin + ijk.to(dtype) * self.cell

    def on_wall(self, ijk: Int64[Tensor, "n 3"]) -> Tensor:
        """Whether corners lie on the outer wall of the grid. "n" booleans."""
        shape = torch.tensor(self.shape, device=ijk.device)
        return ((ijk <= 0) | (ijk >= shape)).any(dim=1)

    def cells_at(self, points: Float[Tensor, "n 3"]) -> Int64[Tensor, "n 3"]:
        """Coordinates of the cells that hold the points; points outside go to the nearest cell."""
        origin = torch.tensor(self.origin, dtype=points.dtype, device=points.device)
        top = torch.tensor(self.shape, device=points.device) - 1
        return ((points - origin) / self.cell).floor().long().clamp(min=0).minimum(top)


def grid_over_box(half_sides: Float[Tensor, " 3"], cells: int, level: int = 0, margin_cells: int = 2) -> Grid:
    """A grid over the box [-half_sides, half_sides] with about ``cells`` cells along its longest side at level 0.

    ``margin_cells`` cells of level 0 are left around the box. Short sides get fewer cells, so a flat object costs less.
    """
    cell = 2 * float(half_sides.max()) / cells
    counts = [max(1, round(2 * float(s) / cell + 0.499)) + 2 * margin_cells for s in half_sides]
    x, y, z = counts
    origin = (-0.5 * x * cell, -0.5 * y * cell, -0.5 * z * cell)
    return Grid(origin=origin, base_shape=(x, y, z), base_cell=cell, level=level)
