"""Which cells an octree splits: how fine the surface is wanted where.

Pure functions. The surface is wanted at one level, coarser where no view would show so small cells, and finer in boxes;
everything else is as coarse as balance allows.
Before an extraction these say which of the cells the surface was in are finer than wanted (``coarsen``); the extraction
makes the tree anew from those whose corners differ in sign (``octree_band.grow_octree``).
Cells that the surface has left are merged by not being named, and what is split depends on the surface and the boxes,
not on how they came about.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from sculpt_framework.geometry.band import levels_of, parents
from sculpt_framework.geometry.grid import Grid, unpack_ijk
from sculpt_framework.geometry.octree import WantedLevels, vertex_level
from sculpt_framework.types import Box, Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class RefineBox:
    """A box, in the frame of the grid, in which the surface is wanted on finer cells."""

    box: Box
    levels: int
    """How many levels finer than elsewhere; each halves the cells."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelMap:
    """The finest level that is worth while, by the cell of level 0 that a place lies in."""

    levels: Int64[Tensor, "x y z"]

    def at(self, cells: Int64[Tensor, " n"]) -> Int64[Tensor, " n"]:
        """Of cells of any level."""
        x, y, z = (unpack_ijk(cells) >> levels_of(cells)[:, None]).unbind(dim=1)
        return self.levels[x, y, z]


def level_map(grid: Grid, cameras: Sequence[Camera], pixels: float) -> LevelMap:
    """The finest levels with cells no smaller than so many pixels of the camera that shows them best.

    A cell of level 0 counts as seen from its point next to the camera, if a ball round it meets the image; whether
    something is in front is not asked. What no camera sees is worth level 0. ``grid`` may be of any level.
    """
    coarse = grid.at_level(0)
    ijk = torch.cartesian_prod(*(torch.arange(n) for n in coarse.shape))
    centers = coarse.corner_positions(ijk, torch.float64) + 0.5 * coarse.cell
    reach = 0.5 * 3**0.5 * coarse.cell
    side = torch.full((len(ijk),), torch.inf, dtype=torch.float64)
    for camera in cameras:
        pose = camera.world_to_camera.double().cpu()
        local = centers @ pose[:3, :3].T + pose[:3, 3]
        depth = local[:, 2]
        seen = depth > -reach
        for axis, focal, center, count in (
            (0, camera.fx, camera.cx, camera.width),
            (1, camera.fy, camera.cy, camera.height),
        ):
            # Distances from the planes through the camera and the image's edges, positive inside.
            for low, edge in ((1.0, -center / focal), (-1.0, (count - center) / focal)):
                seen &= low * (local[:, axis] - edge * depth) / (1 + edge * edge) ** 0.5 > -reach
        nearest = (depth - reach).clamp(min=1e-6 * coarse.cell) / max(camera.fx, camera.fy)
        side = torch.where(seen, side.minimum(nearest), side)
    worth = torch.log2(coarse.cell / (pixels * side)).floor().clamp(min=0, max=vertex_level(coarse))
    return LevelMap(levels=worth.long().reshape(coarse.shape))


def roots_under(grid: Grid, worth: LevelMap | None) -> Grid:
    """The grid of the largest cells that are wanted where the grid's are the smallest but for boxes."""
    return grid if worth is None else grid.at_level(min(grid.level, int(worth.levels.min())))


def wanted_levels(grid: Grid, boxes: Sequence[RefineBox] = (), worth: LevelMap | None = None) -> WantedLevels:
    """The level of the grid, or a coarser one where that is all that is ``worth`` while; in cells that a box reaches
    into as many levels more than the grid's as the box says.

    Raises ValueError where these are more levels than the grid has coordinates for.
    """
    finest = grid.level + max((box.levels for box in boxes), default=0)
    if finest > vertex_level(grid):
        raise ValueError(f"boxes ask for level {finest}, but the finest level of this grid is {vertex_level(grid)}")

    def wanted(cells: Int64[Tensor, " n"]) -> Int64[Tensor, " n"]:
        level = torch.full_like(cells, grid.level) if worth is None else worth.at(cells).clamp(max=grid.level)
        if boxes:
            low, high = extent(grid, cells)
            for each in boxes:
                reached = (high > each.box.minimum.to(low)) & (low < each.box.maximum.to(low))
                level = torch.where(reached.all(dim=1), level.clamp(min=grid.level + each.levels), level)
        return level

    return wanted


def reached_along(grid: Grid, box: Box) -> list[Bool[Tensor, " _"]]:
    """Which layers of the grid's cells, along each axis, the box reaches into: into a cell if into all its layers."""
    layers = []
    minimum, maximum = box.minimum.tolist(), box.maximum.tolist()
    for axis, count in enumerate(grid.shape):
        low = grid.origin[axis] + torch.arange(count, dtype=torch.float64) * grid.cell
        layers.append((low + grid.cell > minimum[axis]) & (low < maximum[axis]))
    return layers


def coarsen(grid: Grid, cells: Int64[Tensor, " n"], wanted: WantedLevels) -> Int64[Tensor, " m"]:
    """Keys, ascending, of the largest cells round the given ones that are fine enough; these stay if they are not."""
    while True:
        above = parents(cells)
        enough = levels_of(cells) > grid.level
        enough[enough.clone()] = levels_of(above[enough]) >= wanted(above[enough])
        if not bool(enough.any()):
            return cells.unique()
        cells = torch.where(enough, above, cells)


def extent(grid: Grid, cells: Int64[Tensor, " n"]) -> tuple[Float64[Tensor, "n 3"], Float64[Tensor, "n 3"]]:
    """Lowest and highest corners of cells of any level."""
    side = grid.base_cell * torch.pow(0.5, levels_of(cells).double())[:, None]
    low = torch.tensor(grid.origin, dtype=torch.float64, device=cells.device) + unpack_ijk(cells) * side
    return low, low + side
