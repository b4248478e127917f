"""A surface held outside boxes: to the bit but for one ring of cells, whatever the field does."""

from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.extractors import Extraction, RefiningExtractor
from sculpt_framework.geometry.band import discover, levels_of
from sculpt_framework.geometry.grid import Grid, grid_over_box
from sculpt_framework.geometry.octree_hold import Hold
from sculpt_framework.geometry.octree_policy import RefineBox, reached_along
from sculpt_framework.geometry.topology import euler_characteristic
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
EARLIER = RefineBox(box=Box.between((-0.9, -0.4, -0.5), (-0.2, 0.4, 0.5)), levels=1)
BOX = RefineBox(box=Box.between((0.05, -0.35, -0.4), (0.7, 0.35, 0.4)), levels=1)
OVERLAPPING = RefineBox(box=Box.between((-0.25, 0.2, -0.6), (0.15, 0.6, 0.6)), levels=2)


def unit_grid() -> Grid:
    return grid_over_box(torch.tensor([1.0, 0.9, 0.7]), cells=20)


def waves(points: Tensor) -> Tensor:
    return 0.02 * torch.sin(points * 23.0).sum(dim=1)


def before(points: Tensor) -> Tensor:
    return torus_sdf(0.5, 0.21)(points) + waves(points)


def after(points: Tensor) -> Tensor:
    """Shifted, swollen, and with more matter near the boxes and far from them."""
    bumps = torch.minimum(sphere_sdf(0.25, (0.4, 0.3, 0.2))(points), sphere_sdf(0.2, (-0.6, -0.6, 0.0))(points))
    return torch.minimum(before(points + 0.03) - 0.02, bumps)


def learned(
    config: ExtractorConfig, grid: Grid, boxes: Sequence[RefineBox]
) -> tuple[RefiningExtractor, Tensor, Extraction]:
    """An extractor with rows that are not neutral, seeds, and the surface it makes from them."""
    extractor = config.build(grid, CPU)
    assert isinstance(extractor, RefiningExtractor)
    extractor.cells.set_boxes(boxes)
    seeds = extractor.extract(before, discover(before, grid, 0)).cells
    extractor.extract(before, seeds)
    shake(extractor, seed=1)
    return extractor, seeds, extractor.extract(before, seeds)


def shake(extractor: RefiningExtractor, seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    for table in extractor.tables.values():
        for leaf in table.leaves.values():
            if leaf.requires_grad:
                leaf.data += 0.3 * torch.randn(leaf.shape, generator=random)


def far_vertices(extraction: Extraction, boxes: Sequence[Box], rings: int) -> Tensor:
    """Vertices, in order, beyond the cells that a box reaches into and so many rings of cells round them."""
    grid, vertices = extraction.grid, extraction.surface.vertices.detach()
    far = torch.ones(len(vertices), dtype=torch.bool)
    for box in boxes:
        near = torch.ones_like(far)
        for axis, layers in enumerate(reached_along(grid, box)):
            inside = torch.nonzero(layers)
            low = grid.origin[axis] + grid.cell * (int(inside.min()) - rings)
            high = grid.origin[axis] + grid.cell * (int(inside.max()) + 1 + rings)
            near &= (vertices[:, axis] >= low - 1e-6) & (vertices[:, axis] <= high + 1e-6)
        far &= ~near
    return torch.unique(vertices[far], dim=0)


@pytest.mark.parametrize(
    ("name", "earlier", "boxes"),
    [
        ("diagonal", (), (BOX,)),
        ("diagonal", (EARLIER,), (BOX, OVERLAPPING)),
        ("center", (), (BOX, OVERLAPPING)),
        ("center", (EARLIER,), (OVERLAPPING,)),
        ("tetrahedra", (), (OVERLAPPING,)),
        ("tetrahedra", (EARLIER,), (BOX,)),
    ],
)
def test_outside_nothing_moves_but_one_ring(name: str, earlier: Sequence[RefineBox], boxes: Sequence[RefineBox]):
    config, grid, areas = CONFIGS[name], unit_grid(), [each.box for each in boxes]
    extractor, seeds, whole = learned(config, grid, earlier)
    extractor.cells.hold_outside(areas, extractor.surface_to_hold(before, seeds))
    extractor.cells.set_boxes((*earlier, *boxes))
    # Each level after the first is led up to by a ring of cells of the size between.
    rings = max(box.levels for box in boxes)
    # Corners may be shifted by half a cell, so a vertex may be that far from the cell it belongs to.
    slack = 1 if name == "center" else 0
    expected = far_vertices(whole, areas, rings + slack)
    assert 0.1 < len(expected) / len(whole.surface.vertices) < 0.95
    for step in range(2):
        found = extractor.extract(after, seeds)
        seeds = found.cells
        shake(extractor, seed=step)
        check_extraction(found)
        assert torch.equal(far_vertices(found, areas, rings + slack), expected)
        assert bool((levels_of(found.cells[free_cells(grid, areas, found)]) > 0).all())


def test_a_sheet_thinner_than_the_cells_stays_as_they_saw_it():
    def sheet(points: Tensor) -> Tensor:
        return sphere_sdf(0.6)(points).abs() - 0.03

    grid, area = unit_grid(), OVERLAPPING.box
    free, holding = (CONFIGS["tetrahedra"].build(grid, CPU) for _ in range(2))
    assert isinstance(free, RefiningExtractor)
    assert isinstance(holding, RefiningExtractor)
    whole = free.extract(sheet, discover(sheet, grid, 0))
    expected = far_vertices(whole, [area], rings=2)
    # At smaller cells beside the box the field shows more of the sheet, and that asks for smaller cells again.
    free.cells.set_boxes([OVERLAPPING])
    shown = far_vertices(free.extract(sheet, whole.cells), [area], rings=2)
    assert len(shown) > 1.3 * len(expected)
    holding.cells.hold_outside([area], holding.surface_to_hold(sheet, whole.cells))
    holding.cells.set_boxes([OVERLAPPING])
    found = holding.extract(sheet, whole.cells)
    check_extraction(found)
    assert torch.equal(far_vertices(found, [area], rings=2), expected)


def free_cells(grid: Grid, boxes: Sequence[Box], found: Extraction) -> Tensor:
    """Which cells lie in cells of the grid that a box reaches into."""
    return Hold(grid, boxes).is_free(found.cells)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_what_is_held_passes_to_another_extractor_by_its_tables(config: ExtractorConfig):
    grid = unit_grid()
    extractor, seeds, whole = learned(config, grid, ())
    extractor.cells.hold_outside([BOX.box], extractor.surface_to_hold(before, seeds))
    extractor.cells.set_boxes([BOX])
    extractor.extract(after, whole.cells)
    here = extractor.extract(after, whole.cells)
    other = config.build(grid, CPU)
    assert isinstance(other, RefiningExtractor)
    other.cells.set_boxes([BOX])
    other.cells.hold_outside([BOX.box])
    for name, table in other.tables.items():
        table.load_state(extractor.tables[name].state())
    there = other.extract(after, whole.cells)
    assert torch.equal(there.surface.vertices, here.surface.vertices)
    assert torch.equal(there.surface.face_keys, here.surface.face_keys)
    with pytest.raises(ValueError, match="stays what it is"):
        other.set_grid(grid.at_level(1))


def test_gradient_reaches_the_field_in_the_boxes_only():
    grid = unit_grid()
    extractor, seeds, whole = learned(CONFIGS["diagonal"], grid, ())
    extractor.cells.hold_outside([BOX.box], extractor.surface_to_hold(before, seeds))
    extractor.cells.set_boxes([BOX])
    asked: list[Tensor] = []

    def sdf(points: Tensor) -> Tensor:
        points = points.detach().requires_grad_()
        asked.append(points)
        return after(points)

    extractor.extract(sdf, whole.cells).surface.vertices.square().sum().backward()
    moved = torch.cat([points.detach() for points in asked if points.grad is not None])
    layers = reached_along(grid, BOX.box)
    for axis in range(3):
        inside = torch.nonzero(layers[axis])
        assert float(moved[:, axis].min()) > grid.origin[axis] + grid.cell * int(inside.min())
        assert float(moved[:, axis].max()) < grid.origin[axis] + grid.cell * (int(inside.max()) + 1)


@pytest.mark.parametrize("value", [0.5, -0.5], ids=["emptied", "filled"])
def test_the_surface_cannot_leave_the_boxes(value: float):
    # Whatever is wanted inside, the rim stays: all matter goes, or all of the box is filled.
    grid = unit_grid()
    sdf = sphere_sdf(0.61)
    extractor = CONFIGS["diagonal"].build(grid, CPU)
    assert isinstance(extractor, RefiningExtractor)
    box = RefineBox(box=Box.between((0.3, -0.9, -0.9), (0.9, 0.9, 0.9)), levels=1)
    extractor.cells.hold_outside([box.box], extractor.surface_to_hold(sdf, discover(sdf, grid, 0)))
    extractor.cells.set_boxes([box])
    found = extractor.extract(lambda points: torch.full_like(points[:, 0], value), discover(sdf, grid, 0))
    check_extraction(found)
    assert euler_characteristic(found.surface.faces) == 2
    reach = float(found.surface.vertices.detach()[:, 0].max())
    assert reach < 0.4 if value > 0 else reach > 0.8


def test_a_box_that_holds_all_of_the_surface_holds_nothing():
    grid = unit_grid()
    extractor, seeds, whole = learned(CONFIGS["diagonal"], grid, ())
    box = RefineBox(box=Box.between((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), levels=1)
    extractor.cells.hold_outside([box.box], extractor.surface_to_hold(before, seeds))
    extractor.cells.set_boxes([box])
    held = extractor.extract(after, whole.cells)
    free = CONFIGS["diagonal"].build(grid, CPU)
    assert isinstance(free, RefiningExtractor)
    free.cells.set_boxes([box])
    for name, table in free.tables.items():
        table.load_state(extractor.tables[name].state())
    assert torch.equal(free.extract(after, whole.cells).surface.face_keys, held.surface.face_keys)
