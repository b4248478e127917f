"""Which cells are split, and how few."""

import numpy as np
import pytest
import torch
from octree_cases import box_grid, sampler

from sculpt_framework.geometry.band import cells_at_level, discover, levels_of, parents
from sculpt_framework.geometry.grid import Grid, grid_over_box, pack, unpack_ijk
from sculpt_framework.geometry.octree import leaves, vertex_level
from sculpt_framework.geometry.octree_band import grow_octree
from sculpt_framework.geometry.octree_policy import (
    LevelMap,
    RefineBox,
    coarsen,
    level_map,
    roots_under,
    wanted_levels,
)
from sculpt_framework.testing import sphere_sdf
from sculpt_framework.types import Box, Camera

BOX = RefineBox(box=Box.between((0.3, -0.2, -0.2), (0.7, 0.2, 0.2)), levels=2)


def middle(grid: Grid, cells: torch.Tensor) -> torch.Tensor:
    side = grid.base_cell * 0.5 ** levels_of(cells)[:, None]
    return torch.tensor(grid.origin) + (unpack_ijk(cells) + 0.5) * side


def test_boxes_ask_for_finer_levels_where_they_reach_into_a_cell():
    grid = box_grid((4, 4, 4), level=1)  # Cells of 1/4.
    wanted = wanted_levels(grid, [BOX, RefineBox(box=Box.between((-0.9, -0.9, -0.9), (0.35, 0.0, 0.0)), levels=1)])
    cells = pack(1, torch.tensor([[5, 4, 4], [4, 4, 4], [7, 7, 7], [0, 0, 0], [5, 3, 3], [5, 2, 3]]))
    assert wanted(cells).tolist() == [3, 1, 1, 2, 3, 2]
    assert wanted_levels(grid)(cells).tolist() == [1] * 6
    fine = cells_at_level(cells[:1], 2)
    inside = ((middle(grid, fine) - 0.5 * 0.0625 < BOX.box.maximum).all(dim=1)) & (
        (middle(grid, fine) + 0.5 * 0.0625 > BOX.box.minimum).all(dim=1)
    )
    assert torch.equal(wanted(fine) == 3, inside)


def test_too_many_levels_are_refused():
    grid = box_grid((4, 4, 4), level=vertex_level(box_grid((4, 4, 4))) - 1)
    with pytest.raises(ValueError, match="the finest level of this grid is"):
        wanted_levels(grid, [BOX])


def test_a_tree_is_fine_at_the_surface_in_the_box_and_coarse_elsewhere():
    grid = grid_over_box(torch.ones(3), cells=20)
    sdf = sphere_sdf(0.61)
    band = grow_octree(sampler(sdf, grid), grid, discover(sdf, grid, 0), wanted_levels(grid, [BOX]))
    found = leaves(band.tree)
    assert bool(torch.isin(band.cells, found).all())
    apart = (middle(grid, found) - torch.tensor([0.5, 0.0, 0.0])).abs()
    far_from_box = (apart > 0.2 + 2.1 * grid.cell).any(dim=1)
    assert bool((levels_of(found[far_from_box]) == 0).all())
    in_box = (apart < 0.2).all(dim=1)
    surface = torch.isin(found, band.cells)
    assert bool((levels_of(found[in_box & surface]) == 2).all())
    assert float(sdf(middle(grid, found[levels_of(found) == 2]).float()).abs().max()) < 1.8 * grid.cell


def test_the_surface_is_split_as_it_moves_and_merged_where_it_left():
    grid = grid_over_box(torch.ones(3), cells=20)
    wanted = wanted_levels(grid, [BOX])
    cells = discover(sphere_sdf(0.45), grid, 0)
    for radius in np.linspace(0.45, 0.85, 9):  # Through the box and out of it.
        sdf = sphere_sdf(float(radius))
        band = grow_octree(sampler(sdf, grid), grid, coarsen(grid, cells, wanted), wanted)
        assert bool((levels_of(band.cells) >= wanted(band.cells)).all())
        # What comes out does not depend on where the surface was before, nor on how it was found.
        fresh = [discover(sdf, grid.at_level(level), 0) for level in (0, 2)]
        for seeds in (*fresh, coarsen(grid, band.cells, wanted), band.cells[:1]):
            again = grow_octree(sampler(sdf, grid), grid, coarsen(grid, seeds, wanted), wanted)
            assert torch.equal(band.cells, again.cells)
            assert torch.equal(band.tree.split_cells, again.tree.split_cells)
        cells = band.cells
    assert bool((levels_of(cells) == 0).all())


def test_coarsening_gives_the_largest_cells_that_are_fine_enough():
    grid = box_grid((4, 4, 4))
    wanted = wanted_levels(grid, [RefineBox(box=Box.between((-1.0, -1.0, -1.0), (-0.4, 1.0, 1.0)), levels=2)])
    deep = cells_at_level(pack(0, torch.tensor([[0, 1, 1], [1, 1, 1], [3, 2, 2]])), 3)
    cells = coarsen(grid, deep, wanted)
    assert torch.equal(cells, cells.unique())
    assert bool((levels_of(cells) >= wanted(cells)).all())
    above = parents(cells[levels_of(cells) > 0])
    assert bool((levels_of(above) < wanted(above)).all())
    assert torch.bincount(levels_of(cells)).tolist() == [1, 4, 64 + 32]
    coarse = pack(0, torch.tensor([[0, 1, 1]]))
    assert torch.equal(coarsen(grid, coarse, wanted), coarse)


def camera_at(place: tuple[float, float, float], focal: float, size: int) -> Camera:
    """A camera that looks along -x from ``place``."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], dtype=torch.float64)
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor(place, dtype=torch.float64)
    return Camera(world_to_camera=pose, fx=focal, fy=focal, cx=size / 2, cy=size / 2, width=size, height=size)


def test_levels_that_pixels_are_worth():
    grid = grid_over_box(torch.tensor([1.0, 1.0, 1.0]), cells=8)
    near, far = camera_at((3.0, 0.5, 0.5), 200.0, 100), camera_at((9.0, 0.0, 0.0), 200.0, 400)
    both = level_map(grid, [near, far], 2.0).levels
    wide = level_map(grid, [far], 2.0).levels
    assert bool((both >= wide).all())
    random = torch.Generator().manual_seed(3)
    points = 2.4 * torch.rand(3000, 3, generator=random, dtype=torch.float64) - 1.2
    cells = pack(0, grid.cells_at(points))
    for worth, cameras in ((both, [near, far]), (wide, [far])):
        best = torch.zeros(len(points), dtype=torch.float64)
        for camera in cameras:
            local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
            pixel = local[:, :2] / local[:, 2:] * camera.fx + camera.cx
            inside = ((pixel > 0) & (pixel < camera.width)).all(dim=1) & (local[:, 2] > 0)
            best = torch.where(inside, torch.maximum(best, camera.fx / local[:, 2]), best)
        # The level is that of the point of a cell next to a camera, so never too coarse, and little too fine.
        found = LevelMap(levels=worth).at(cells).double()
        justified = torch.log2(grid.base_cell * best / 2.0).floor().clamp(min=0)
        assert bool((found >= justified).all())
        seen = best > 0
        if len(cameras) == 1:
            assert bool((found[seen] <= justified[seen] + 1).all())
    # Of what the near camera alone would show better, most lies outside its image and is left to the far one.
    assert 0.0 < float((both > wide).double().mean()) < 0.9
    assert level_map(grid, [], 2.0).levels.max() == 0


def test_wanted_levels_follow_what_is_worth_while():
    grid = grid_over_box(torch.tensor([1.0, 1.0, 1.0]), cells=8, level=2)
    levels = torch.zeros(grid.base_shape, dtype=torch.int64)
    levels[levels.shape[0] // 2 :] = 1
    levels[-3:] = 5
    box = RefineBox(box=Box.between((-0.3, -0.3, -0.3), (-0.1, 0.1, 0.1)), levels=1)
    wanted = wanted_levels(grid, [box], LevelMap(levels=levels))
    x = torch.tensor([0, 7, 9])
    roots = pack(0, torch.stack([x, torch.full_like(x, 1), torch.full_like(x, 1)], dim=1))
    assert wanted(roots).tolist() == [0, 1, 2]
    assert wanted(cells_at_level(roots, 2)).unique().tolist() == [0, 1, 2]
    reached = pack(2, grid.cells_at(torch.tensor([[-0.2, 0.0, 0.0]])))
    assert wanted(reached).tolist() == [3]
    assert roots_under(grid, LevelMap(levels=levels)).level == 0
    assert roots_under(grid, LevelMap(levels=levels + 1)).level == 1
    assert roots_under(grid, LevelMap(levels=levels + 9)) == grid
