"""Larger cells where smaller ones are not worth while: the contract, what they cost and spare, boxes all the same."""

import math

import pytest
import torch
from torch import Tensor

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.extractors import RefiningExtractor
from sculpt_framework.geometry.band import cells_at_level, discover, levels_of
from sculpt_framework.geometry.grid import Grid, grid_over_box, unpack_ijk
from sculpt_framework.geometry.octree_policy import LevelMap, RefineBox, wanted_levels
from sculpt_framework.geometry.topology import euler_characteristic, signed_volume
from sculpt_framework.testing import check_extraction, sphere_sdf, torus_sdf
from sculpt_framework.types import Box
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig

CPU = torch.device("cpu")
CONFIGS = {
    "diagonal": FlexiCubesConfig(),
    "center": FlexiCubesConfig(split="center", learn_deformation=True),
    "tetrahedra": MarchingTetrahedraConfig(),
}
TORUS = torus_sdf(0.55, 0.22)
BOX = RefineBox(box=Box.between((-0.9, -0.2, -0.3), (-0.3, 0.2, 0.3)), levels=1)


def unit_grid(level: int = 2) -> Grid:
    return grid_over_box(torch.tensor([1.0, 1.0, 0.7]), cells=10, level=level)


def falling(grid: Grid) -> LevelMap:
    """Levels 0 to 3 along x."""
    x, y, z = grid.base_shape
    levels = (torch.arange(x) * 4 // x)[:, None, None].expand(x, y, z)
    return LevelMap(levels=levels.contiguous())


def sparing(config: ExtractorConfig, grid: Grid) -> RefiningExtractor:
    extractor = config.build(grid, CPU)
    assert isinstance(extractor, RefiningExtractor)
    extractor.cells.set_worth(falling(grid))
    return extractor


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_cells_are_as_large_as_is_worth_while(config: ExtractorConfig):
    grid = unit_grid()
    extractor = sparing(config, grid)
    found = extractor.extract(TORUS, discover(TORUS, grid, 0))
    check_extraction(found)
    level, wanted = levels_of(found.cells), wanted_levels(grid, (), falling(grid))(found.cells)
    assert level.unique().tolist() == [0, 1, 2]
    # Finer ones are there for balance alone, next to those that are wanted so fine.
    assert bool((level >= wanted).all())
    assert float((level == wanted).double().mean()) > 0.75
    assert euler_characteristic(found.surface.faces) == 0
    volume = 2 * math.pi**2 * 0.55 * 0.22**2
    assert signed_volume(found.surface.vertices, found.surface.faces) == pytest.approx(volume, rel=0.08)
    again = extractor.extract(TORUS, found.cells)
    assert torch.equal(again.cells, found.cells)
    plain = config.build(grid, CPU).extract(TORUS, discover(TORUS, grid, 0))
    assert len(found.surface.faces) < 0.75 * len(plain.surface.faces)


@pytest.mark.parametrize("name", ["diagonal", "tetrahedra"])
def test_where_all_is_worth_while_nothing_changes(name: str):
    grid = unit_grid()
    seeds = discover(TORUS, grid, 0)
    plain = CONFIGS[name].build(grid, CPU).extract(TORUS, seeds).surface
    extractor = CONFIGS[name].build(grid, CPU)
    assert isinstance(extractor, RefiningExtractor)
    extractor.cells.set_worth(LevelMap(levels=torch.full(grid.base_shape, 7)))
    same = extractor.extract(TORUS, seeds).surface
    assert torch.equal(torch.unique(same.vertices, dim=0), torch.unique(plain.vertices, dim=0))
    assert torch.equal(same.face_keys.sort().values, plain.face_keys.sort().values)
    extractor.cells.set_worth(None)
    assert torch.equal(extractor.extract(TORUS, seeds).surface.vertices, plain.vertices)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_stages_boxes_and_holding_go_together_with_it(config: ExtractorConfig):
    extractor = sparing(config, unit_grid(1))
    cells = extractor.extract(TORUS, discover(TORUS, unit_grid(1), 0)).cells
    extractor.set_grid(unit_grid(2))
    seeds = extractor.extract(TORUS, cells_at_level(cells, 1)).cells
    whole = extractor.extract(TORUS, seeds)
    assert levels_of(whole.cells).unique().tolist() == [0, 1, 2]
    extractor.cells.hold_outside([BOX.box], extractor.surface_to_hold(TORUS, seeds))
    extractor.cells.set_boxes([BOX])

    def swollen(points: Tensor) -> Tensor:
        return TORUS(points) - 0.02

    found = extractor.extract(swollen, whole.cells)
    check_extraction(found)
    assert levels_of(found.cells).unique().tolist() == [0, 1, 2, 3]
    side = found.grid.base_cell * 0.5 ** levels_of(found.cells)[:, None]
    low = torch.tensor(found.grid.origin) + unpack_ijk(found.cells) * side
    reached = (low < BOX.box.maximum) & (low + side > BOX.box.minimum)
    assert bool((levels_of(found.cells)[reached.all(dim=1)] == 3).all())
    # Half the object away nothing has moved.
    there, here = (s.vertices.detach()[s.vertices[:, 0] > 0.3] for s in (whole.surface, found.surface))
    assert len(there) > 100
    assert torch.equal(torch.unique(there, dim=0), torch.unique(here, dim=0))


def test_what_is_smaller_than_the_cells_is_lost_with_them():
    # A ball within one large cell: seen by the small ones only.
    grid = unit_grid()
    ball = sphere_sdf(0.08, (-0.9, 0.1, 0.1))
    cells = discover(ball, grid, 0)
    assert len(CONFIGS["diagonal"].build(grid, CPU).extract(ball, cells).cells) > 0
    both = sparing(CONFIGS["diagonal"], grid).extract(
        lambda points: torch.minimum(ball(points), TORUS(points)),
        torch.cat([cells, discover(TORUS, grid, 0)]).unique(),
    )
    assert euler_characteristic(both.surface.faces) == 0
