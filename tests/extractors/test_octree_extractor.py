"""``flexicubes`` with boxes in which it refines, and what becomes of its tables when cells split and merge."""

import math

import pytest
import torch
from torch import Tensor

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.extractors import RefiningExtractor
from sculpt_framework.geometry.band import cells_at_level, discover, levels_of, parents
from sculpt_framework.geometry.grid import Grid, grid_over_box, pack, unpack_ijk
from sculpt_framework.geometry.keys import find
from sculpt_framework.geometry.octree import heirs, vertex_level
from sculpt_framework.geometry.octree_policy import RefineBox, wanted_levels
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.geometry.topology import components, euler_characteristic, signed_volume
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.testing import box_sdf, check_extraction, kept_faces, sphere_sdf, torus_sdf
from sculpt_framework.types import Box
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.extractor import FlexiCubes
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.losses.eikonal.loss import Eikonal

CPU = torch.device("cpu")
BOXES = (
    RefineBox(box=Box.between((0.2, -0.3, -0.3), (0.9, 0.3, 0.3)), levels=2),
    RefineBox(box=Box.between((-0.9, 0.1, -0.9), (-0.2, 0.7, 0.9)), levels=1),
)
CONFIGS = {
    "diagonal": FlexiCubesConfig(learn_weights=False),
    "center": FlexiCubesConfig(split="center"),
    "deformed": FlexiCubesConfig(learn_deformation=True),
    "tetrahedra": MarchingTetrahedraConfig(),
}


def unit_grid(cells: int = 12, level: int = 0) -> Grid:
    return grid_over_box(torch.tensor([1.0, 0.9, 0.7]), cells=cells, level=level)


def refining(config: ExtractorConfig, grid: Grid) -> RefiningExtractor:
    extractor = config.build(grid, CPU)
    assert isinstance(extractor, RefiningExtractor)
    extractor.cells.set_boxes(BOXES)
    return extractor


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.parametrize(
    ("sdf", "euler", "volume"),
    [
        (sphere_sdf(0.61), 2, 4 / 3 * math.pi * 0.61**3),
        (torus_sdf(0.55, 0.22), 0, 2 * math.pi**2 * 0.55 * 0.22**2),
        (box_sdf((0.47, 0.61, 0.39)), 2, 8 * 0.47 * 0.61 * 0.39),
    ],
    ids=["sphere", "torus", "box"],
)
def test_the_contract_holds_with_boxes(config: ExtractorConfig, sdf: SdfFunction, euler: int, volume: float):
    grid = unit_grid(level=1)
    extractor = refining(config, grid)
    seeds = discover(sdf, grid, 0)
    full = extractor.extract(sdf, seeds)
    check_extraction(full)
    assert levels_of(full.cells).unique().tolist() == [1, 2, 3]
    assert bool((levels_of(full.cells) >= wanted_levels(grid, BOXES)(full.cells)).all())
    assert components(full.surface.faces)[0] == 1
    assert euler_characteristic(full.surface.faces) == euler
    assert signed_volume(full.surface.vertices, full.surface.faces) == pytest.approx(volume, rel=0.05)
    again = extractor.extract(sdf, full.cells)
    assert torch.equal(again.surface.faces, full.surface.faces)
    assert torch.equal(again.surface.vertices, full.surface.vertices)
    assert torch.equal(again.surface.face_keys, full.surface.face_keys)
    one = refining(config, grid).extract(sdf, full.cells[-1:])
    assert torch.equal(one.cells, full.cells)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_extremes_with_boxes(config: ExtractorConfig):
    grid = unit_grid()
    seeds = discover(lambda points: 0 * points[:, 0], grid, 0)
    for value in (1.0, 0.0):
        with pytest.raises(EmptySurfaceError):
            refining(config, grid).extract(lambda points, v=value: torch.full_like(points[:, 0], v), seeds)
    with pytest.raises(EmptySurfaceError):
        refining(config, grid).extract(sphere_sdf(0.6), seeds[:0])
    solid = refining(config, grid).extract(lambda points: torch.full_like(points[:, 0], -1.0), seeds)
    check_extraction(solid)
    values = torch.full((1,), 1e-30, requires_grad=True)

    def stiff(points: Tensor) -> Tensor:
        return values * torch.sign(points[:, 0] + 0.25 * grid.cell) + 0.0 * points[:, 1]

    found = refining(config, grid).extract(stiff, seeds)
    (slope,) = torch.autograd.grad(found.surface.vertices.sum() + found.deviation.sum(), [values])
    assert bool(torch.isfinite(slope).all())


def test_surface_that_moved_out_of_its_cells_is_found_again():
    grid = unit_grid(10)
    box = RefineBox(box=Box.between((0.1, -0.4, -0.4), (0.9, 0.4, 0.4)), levels=3)
    extractor = CONFIGS["diagonal"].build(grid, CPU)
    assert isinstance(extractor, RefiningExtractor)
    extractor.cells.set_boxes([box])
    # A ball of its own, all within the box, grows by more than two of its cells.
    before, after = sphere_sdf(0.2, (0.45, 0.0, 0.0)), sphere_sdf(0.26, (0.45, 0.0, 0.0))
    cells = extractor.extract(before, discover(before, grid, 0)).cells
    assert bool((levels_of(cells) == 3).all())
    found = extractor.extract(after, cells)
    check_extraction(found)
    direct = extractor.extract(after, discover(after, grid, 0))
    assert torch.equal(found.cells, direct.cells)
    far = sphere_sdf(0.04, (0.45, 0.0, 0.0))  # Within one root, and off all seeds.
    with pytest.raises(EmptySurfaceError):
        extractor.extract(far, cells)
    extractor.set_grid(grid.at_level(1))
    with pytest.raises(ValueError, match="coarser levels"):
        extractor.extract(before, cells_at_level(cells, -3))


@pytest.mark.parametrize("name", ["diagonal", "tetrahedra"])
def test_outside_the_boxes_the_surface_is_the_plain_one(name: str):
    grid = unit_grid(32)
    sdf = torus_sdf(0.55, 0.22)
    seeds = discover(sdf, grid, 0)
    plain = CONFIGS[name].build(grid, CPU).extract(sdf, seeds).surface
    refined = refining(CONFIGS[name], grid).extract(sdf, seeds).surface
    kept, new = kept_faces(plain, refined)
    place = plain.vertices[plain.faces]
    reach = torch.zeros(len(place), dtype=torch.bool)
    for each in BOXES:
        # The cells a box reaches into, a ring for each level but the first for the sake of balance, one where a
        # crossing is hidden, and one of cells that touch finer ones.
        slack = (each.levels + 2) * grid.cell
        near = (place > each.box.minimum - slack) & (place < each.box.maximum + slack)
        reach |= near.all(dim=2).any(dim=1)
    assert 0.1 < float(reach.float().mean()) < 0.9
    unchanged = torch.zeros(len(place), dtype=torch.bool)
    unchanged[kept] = (place[kept] == refined.vertices[refined.faces[new]]).all(dim=2).all(dim=1)
    assert bool((unchanged | reach).all())


def test_refining_brings_the_surface_closer_in_the_boxes():
    grid = unit_grid(16)
    sdf = box_sdf((0.47, 0.61, 0.39))
    plain = CONFIGS["diagonal"].build(grid, CPU).extract(sdf, discover(sdf, grid, 0)).surface
    refined = refining(CONFIGS["diagonal"], grid).extract(sdf, discover(sdf, grid, 0)).surface
    errors = []
    for surface in (plain, refined):
        middle = surface.vertices[surface.faces].mean(dim=1)
        corners = surface.vertices[surface.faces]
        area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1)
        inside = (middle > BOXES[0].box.minimum) & (middle < BOXES[0].box.maximum)
        weight = area * inside.all(dim=1)
        errors.append(float((sdf(middle).abs() * weight).sum() / weight.sum()))
    assert errors[1] < 0.3 * errors[0]


def test_boxes_finer_than_there_are_coordinates_are_refused():
    grid = unit_grid()
    deep = RefineBox(box=Box.between((0.0, 0.0, 0.0), (0.1, 0.1, 0.1)), levels=vertex_level(grid) - 1)
    extractor = CONFIGS["diagonal"].build(grid.at_level(1), CPU)
    extractor.cells.set_boxes([deep])
    with pytest.raises(ValueError, match="the finest level"):
        extractor.set_grid(grid.at_level(2))
    with pytest.raises(ValueError, match="the finest level"):
        CONFIGS["diagonal"].build(grid.at_level(2), CPU).cells.set_boxes([deep])


def test_a_finer_grid_refines_in_the_boxes_too():
    grid = unit_grid()
    sdf = sphere_sdf(0.6)
    extractor = refining(CONFIGS["center"], grid)
    cells = extractor.extract(sdf, discover(sdf, grid, 0)).cells
    extractor.set_grid(grid.at_level(1))
    found = extractor.extract(sdf, cells_at_level(cells, 1))
    check_extraction(found)
    assert levels_of(found.cells).unique().tolist() == [1, 2, 3]
    extractor.set_grid(grid)
    back = extractor.extract(sdf, cells_at_level(found.cells, -1))
    assert torch.equal(back.cells, cells)


# --------------------------------------------------------------------------------------------------------------- tables


def test_heirs_are_children_of_what_was_split_and_parents_of_what_was_merged():
    place = torch.tensor([[1, 1, 1]])
    whole, parts = pack(1, place), cells_at_level(pack(1, place), 1)
    other = pack(1, torch.tensor([[3, 3, 3]]))
    new, old = heirs(torch.cat([whole, other]), torch.cat([other, parts]))
    assert new.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert old.tolist() == [0] * 8
    new, old = heirs(torch.cat([other, parts[:3]]), torch.cat([whole, other]))
    assert new.tolist() == [0, 0, 0]
    assert old.tolist() == [1, 2, 3]
    # Two levels at once; a cell that is there takes over from nobody, nor does one with no kin.
    deep = cells_at_level(whole, 2)
    new, old = heirs(torch.cat([whole, other]), torch.cat([other, deep[:5]]).sort().values)
    assert old.tolist() == [0] * 5
    new, old = heirs(deep[:5], torch.cat([whole, other]))
    assert new.tolist() == [0] * 5
    assert sorted(old.tolist()) == [0, 1, 2, 3, 4]
    assert heirs(other, whole)[0].tolist() == []
    # The smallest old cell wins.
    new, old = heirs(torch.cat([whole, parts[2:3]]), cells_at_level(parts[2:3], 1))
    assert old.tolist() == [1] * 8


def test_rows_and_moments_pass_to_the_heirs():
    table = KeyedTable({"a": 0.1})
    table.rekey(torch.tensor([10, 20, 30]), {"a": torch.tensor([[1.0], [2.0], [4.0]])})
    for step in range(2):
        # Row 0 alone has a gradient at first.
        table.leaves["a"].grad = torch.tensor([[1.0], [float(step)], [0.0]])
        table.step()
    before = table.state()
    heir, lender = torch.tensor([1, 1, 2]), torch.tensor([0, 1, 1])
    table.rekey(torch.tensor([30, 40, 50, 60]), {"a": torch.full((4, 1), 7.0)}, (heir, lender))
    after = table.state()
    for name in ("value.a", "first.a", "second.a"):
        old, new = before[name][:, 0], after[name][:, 0]
        expected = [old[2], 0.5 * (old[0] + old[1]), old[1], torch.tensor(7.0 if name == "value.a" else 0.0)]
        torch.testing.assert_close(new, torch.stack(expected))
    assert after["steps"].tolist() == [2, 2, 2, 0]


def test_weights_pass_on_when_boxes_come_and_go():
    grid = unit_grid(16)
    sdf = sphere_sdf(0.6)
    extractor = CONFIGS["center"].build(grid, CPU)
    cells = extractor.extract(sdf, discover(sdf, grid, 0)).cells
    table = extractor.tables["cells"]
    for _ in range(3):
        extractor.extract(sdf, cells).surface.vertices.pow(3).sum().backward()
        table.step()
        table.zero_grad()
    before = table.state()
    assert float(before["first.alpha"].abs().max()) > 0
    extractor.cells.set_boxes(BOXES)
    refined = extractor.extract(sdf, cells)
    split = table.state()
    assert bool((levels_of(refined.cells) == 2).any())
    ancestor = refined.cells.clone()
    while bool((levels_of(ancestor) > 0).any()):
        ancestor = torch.where(levels_of(ancestor) > 0, parents(ancestor), ancestor)
    row, there = find(before["keys"], ancestor)
    assert float(there.float().mean()) > 0.95
    for name in ("value.alpha", "first.beta", "second.beta", "value.gamma", "steps"):
        assert torch.equal(split[name][there], before[name][row[there]])
    extractor.cells.set_boxes(())
    merged = extractor.extract(sdf, refined.cells[levels_of(refined.cells) == 0])
    assert torch.equal(merged.cells, cells)
    after = table.state()
    for name in ("value.alpha", "first.beta", "second.beta", "steps"):
        torch.testing.assert_close(after[name], before[name])


@pytest.mark.parametrize("name", ["alpha", "beta", "gamma", "delta"])
def test_gradient_of_the_tables_through_extraction_with_boxes(name: str):
    grid = unit_grid(7)
    config = FlexiCubesConfig(split="center", learn_deformation=True)
    extractor = FlexiCubes(config, grid, CPU, torch.float64)
    extractor.cells.set_boxes(BOXES)
    sdf = box_sdf((0.52, 0.61, 0.43))
    seeds = extractor.extract(sdf, discover(sdf, grid, 0)).cells
    random = torch.Generator().manual_seed(11)
    with torch.no_grad():
        for table in extractor.tables.values():
            for raw in table.leaves.values():
                raw += 0.2 * torch.randn(raw.shape, generator=random, dtype=torch.float64)
    # Shifting the corners moved the band; once it has settled, rows stay the same tensors.
    for _ in range(5):
        seeds = extractor.extract(sdf, seeds).cells
    assert len(levels_of(seeds).unique()) == 3
    leaf = extractor.tables["corners" if name == "delta" else "cells"].leaves[name]

    def objective() -> Tensor:
        extraction = extractor.extract(sdf, seeds)
        return extraction.surface.vertices.pow(3).sum() + extraction.deviation.sum()

    (slope,) = torch.autograd.grad(objective(), [leaf])
    direction = torch.randn(leaf.shape, generator=random, dtype=torch.float64)
    with torch.no_grad():
        leaf += 1e-6 * direction
        above = objective()
        leaf -= 2e-6 * direction
        below = objective()
    assert float(slope.abs().max()) > 0
    torch.testing.assert_close((slope * direction).sum(), (above - below) / 2e-6, rtol=1e-5, atol=1e-7)


def test_shifts_are_smaller_at_smaller_cells():
    grid = unit_grid(10)
    sdf = sphere_sdf(0.6)
    extractor = refining(CONFIGS["deformed"], grid)
    cells = extractor.extract(sdf, discover(sdf, grid, 0)).cells
    extractor.extract(sdf, cells)
    with torch.no_grad():
        extractor.tables["corners"].leaves["delta"].uniform_(-9, 9, generator=torch.Generator().manual_seed(2))
    found = extractor.extract(sdf, cells)
    check_extraction(found)
    level = levels_of(found.cells)
    unshifted = torch.tensor(grid.origin) + unpack_ijk(found.cells) * (grid.base_cell * 0.5 ** level[:, None])
    shift = (found.corner_positions[found.cell_corners[:, 0]] - unshifted).abs().amax(dim=1).detach()
    known = torch.isin(found.cells, cells)
    assert float(known.float().mean()) > 0.3
    for each in range(3):
        side = grid.base_cell * 0.5**each
        here = shift[known & (level == each)]
        assert float(here.max()) < 0.5 * side
        assert float(here.max()) > 0.25 * side


def test_eikonal_loss_knows_the_sizes_of_the_cells():
    grid = unit_grid(16)
    sdf = sphere_sdf(0.6)
    found = refining(CONFIGS["diagonal"], grid).extract(sdf, discover(sdf, grid, 0))
    assert float(Eikonal()(found)) < 1e-3
    plain = CONFIGS["diagonal"].build(grid, CPU).extract(sdf, discover(sdf, grid, 0))
    assert float(Eikonal()(found)) < float(Eikonal()(plain))


@pytest.mark.gpu
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_cuda_gives_the_same_surface(config: ExtractorConfig):
    grid = unit_grid(16)
    sdf = torus_sdf()
    here = refining(config, grid).extract(sdf, discover(sdf, grid, 0)).surface
    device = torch.device("cuda")
    extractor = config.build(grid, device)
    assert isinstance(extractor, RefiningExtractor)
    extractor.cells.set_boxes(BOXES)
    there = extractor.extract(sdf, discover(sdf, grid, 0, device=device)).surface
    assert torch.equal(there.face_keys.cpu(), here.face_keys)
    assert torch.equal(there.faces.cpu(), here.faces)
    torch.testing.assert_close(there.vertices.cpu(), here.vertices, rtol=1e-5, atol=1e-6)
