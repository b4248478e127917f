"""Gradients and learnable tables of the ``flexicubes`` extractor."""

from dataclasses import fields

import pytest
import torch
from sampled_grids import all_cells, corner_lookup, unit_grid
from torch import Tensor

from sculpt_framework.geometry.band import Band, discover, track
from sculpt_framework.geometry.grid import Grid, grid_over_box, unpack_ijk
from sculpt_framework.testing import box_sdf, check_extraction, sphere_sdf
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.flexicubes.extractor import FlexiCubes
from sculpt_plugins.extractors.flexicubes.geometry import (
    center_split,
    diagonal_split,
    dual_vertices,
    dual_vertices_in_torch,
    second_diagonals_in_torch,
)
from sculpt_plugins.extractors.flexicubes.topology import (
    DualTopology,
    crossed_edges_compiled,
    crossed_edges_in_torch,
    dual_topology,
)

CPU = torch.device("cpu")


def noisy_band(grid: Grid) -> tuple[Band, DualTopology]:
    """A small band with ambiguous faces, values well away from 0, in float64."""
    random = torch.Generator().manual_seed(5)
    noise = torch.rand(tuple(n + 1 for n in grid.shape), generator=random, dtype=torch.float64) + 0.2
    values = torch.where(torch.rand(noise.shape, generator=random) < 0.5, noise, -noise)

    def sample(corners: Tensor) -> tuple[Tensor, Tensor]:
        positions = grid.corner_positions(unpack_ijk(corners), torch.float64)
        return positions, corner_lookup(values)(positions)

    band = track(sample, grid, all_cells(grid))
    return band, dual_topology(band)


def positive(shape: tuple[int, ...]) -> Tensor:
    random = torch.Generator().manual_seed(7)
    return (torch.rand(shape, generator=random, dtype=torch.float64) + 0.5).requires_grad_()


def test_gradient_by_every_input():
    grid = unit_grid((3, 4, 3))
    band, topology = noisy_band(grid)
    cells = len(band.cells)
    inputs = [
        band.corner_positions.clone().requires_grad_(),
        band.corner_sdf.clone().requires_grad_(),
        positive((cells, 8)),
        positive((cells, 12)),
        positive((cells,)),
    ]

    def everything(positions: Tensor, sdf: Tensor, alpha: Tensor, beta: Tensor, gamma: Tensor):
        vertices, deviation = dual_vertices(topology, positions, sdf, grid.cell, alpha, beta)
        return vertices, deviation, center_split(vertices, topology.vertices, gamma[topology.cells])[1]

    assert torch.autograd.gradcheck(everything, inputs, fast_mode=True)
    assert torch.autograd.gradcheck(
        lambda positions, sdf: dual_vertices(topology, positions, sdf, grid.cell), inputs[:2], fast_mode=True
    )


def test_neutral_weights_are_plain_dual_contouring():
    grid = unit_grid((4, 3, 4))
    band, topology = noisy_band(grid)
    plain = dual_vertices(topology, band.corner_positions, band.corner_sdf, grid.cell)
    ones = torch.ones(len(band.cells), 12, dtype=torch.float64)
    weighted = dual_vertices(topology, band.corner_positions, band.corner_sdf, grid.cell, ones[:, :8], ones)
    torch.testing.assert_close(weighted, plain)
    flat = center_split(plain[0], topology.vertices)[1]
    torch.testing.assert_close(center_split(plain[0], topology.vertices, ones[topology.cells, 0])[1], flat)


def test_dual_vertices_stay_in_their_cells():
    grid = unit_grid((5, 5, 5))
    band, topology = noisy_band(grid)
    weights = positive((len(band.cells), 12)).detach() ** 8
    vertices, _ = dual_vertices(topology, band.corner_positions, band.corner_sdf, 1.0, weights[:, :8], weights)
    lowest = unpack_ijk(band.cells)[topology.cells].double()
    inside = vertices[topology.vertices] - lowest
    assert bool(((inside >= 0) & (inside <= 1)).all())


def test_deviation_is_zero_where_all_crossings_are_equally_far():
    grid = unit_grid((3, 3, 3))
    values = torch.ones(4, 4, 4)
    values[1, 1, 1] = -1.0  # An octahedron: each of its 8 cells has 3 crossings round a corner.
    extraction = FlexiCubesConfig(learn_weights=False).build(grid, CPU).extract(corner_lookup(values), all_cells(grid))
    assert extraction.deviation.shape == (8,)
    torch.testing.assert_close(extraction.deviation, torch.zeros(8))


def test_vanishing_sdf_keeps_gradients_finite():
    grid = unit_grid((4, 4, 4))
    values = torch.full((5, 5, 5), 0.0).requires_grad_()
    inside = torch.zeros(5, 5, 5)
    inside[2, 2, 1:4] = -1e-38
    config = FlexiCubesConfig(split="center", learn_deformation=True)
    extraction = config.build(grid, CPU).extract(corner_lookup(values + inside), all_cells(grid))
    check_extraction(extraction)
    total = extraction.surface.vertices.sum() + extraction.deviation.sum()
    assert bool(torch.isfinite(torch.autograd.grad(total, [values])[0]).all())


def test_damped_edges_leave_the_surface_and_bound_its_gradient():
    """A plane that hardly rises along x and y, whose crossings there run hundreds of cells per unit of distance."""
    grid = unit_grid((6, 6, 6))
    i, j, k = torch.meshgrid(*(torch.arange(7.0),) * 3, indexing="ij")
    values = (0.05 * (k - 3.0) + 1e-4 * (i + 0.7 * j - 5.1)).requires_grad_()
    slopes, surfaces = [], []
    for damp in (False, True):
        config = FlexiCubesConfig(damp_grazing=damp)
        surface = config.build(grid, CPU).extract(corner_lookup(values), all_cells(grid)).surface
        surfaces.append(surface.vertices.detach())
        slopes.append(torch.autograd.grad(surface.vertices[:, 0].sum(), [values])[0])
    assert torch.equal(surfaces[0], surfaces[1])
    assert float(slopes[0].abs().max()) > 100 * float(slopes[1].abs().max())
    # No crossing moves by more than one cell where the distance changes by one; a corner ends six edges.
    assert float(slopes[1].abs().max()) <= 6.0


@pytest.mark.parametrize("name", ["alpha", "beta", "gamma", "delta"])
def test_gradient_of_the_tables_through_extraction(name: str):
    grid = grid_over_box(torch.ones(3), cells=7)
    config = FlexiCubesConfig(split="center", learn_deformation=True)
    extractor = FlexiCubes(config, grid, CPU, torch.float64)
    sdf = box_sdf((0.52, 0.61, 0.43))
    seeds = extractor.extract(sdf, discover(sdf, grid, 0)).cells
    random = torch.Generator().manual_seed(11)
    with torch.no_grad():
        for table in extractor.tables.values():
            for raw in table.leaves.values():
                raw += 0.2 * torch.randn(raw.shape, generator=random, dtype=torch.float64)

    # Shifting the corners moved the band; once it has settled, rows stay the same tensors.
    for _ in range(4):
        seeds = extractor.extract(sdf, seeds).cells
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


def test_tables_exist_only_where_something_is_learned():
    grid = grid_over_box(torch.ones(3), cells=8)
    assert FlexiCubesConfig(learn_weights=False).build(grid, CPU).tables == {}
    extractor = FlexiCubesConfig(learn_weights=True).build(grid, CPU)
    extraction = extractor.extract(sphere_sdf(), discover(sphere_sdf(), grid, 0))
    assert set(extractor.tables) == {"cells"}
    assert set(extractor.tables["cells"].leaves) == {"alpha", "beta"}
    assert extraction.cell_weights is not None
    assert extraction.cell_weights.shape == (len(extraction.cells), 20)
    assert extraction.cell_weights.requires_grad


def test_weights_are_kept_while_their_cell_stays_and_survive_a_second_extraction():
    grid = grid_over_box(torch.ones(3), cells=12)
    extractor = FlexiCubesConfig().build(grid, CPU)
    cells = extractor.extract(sphere_sdf(0.6), discover(sphere_sdf(0.6), grid, 0)).cells
    table = extractor.tables["cells"]
    leaf = table.leaves["alpha"]
    extractor.extract(sphere_sdf(0.6), cells).surface.vertices.square().sum().backward()
    assert table.leaves["alpha"] is leaf
    assert leaf.grad is not None
    table.step()
    learned = leaf.detach().clone()
    extractor.extract(sphere_sdf(0.63), cells)
    row, known = table.locate(cells)
    assert 0 < int(known.sum()) < len(cells)
    assert torch.equal(table.leaves["alpha"].detach()[row[known]], learned[known])


def test_finer_cells_inherit_the_weights_of_their_parents():
    grid = grid_over_box(torch.ones(3), cells=8)
    extractor = FlexiCubesConfig().build(grid, CPU)
    extractor.extract(sphere_sdf(0.6), discover(sphere_sdf(0.6), grid, 0))
    table = extractor.tables["cells"]
    with torch.no_grad():
        table.leaves["beta"].fill_(0.25)
    for level in (1, 3):  # One level up, then two at once.
        extractor.set_grid(grid.at_level(level))
        extraction = extractor.extract(sphere_sdf(0.6), discover(sphere_sdf(0.6), extractor.grid, 0))
        check_extraction(extraction)
        assert len(table) == len(extraction.cells)
        assert float((table.leaves["beta"] == 0.25).float().mean()) > 0.95


def test_shifted_corners_stay_within_half_a_cell_and_off_the_wall():
    grid = grid_over_box(torch.ones(3), cells=12)
    sdf = sphere_sdf(1.4)
    extractor = FlexiCubesConfig(learn_deformation=True).build(grid, CPU)
    cells = extractor.extract(sdf, discover(sdf, grid, 0)).cells
    extractor.extract(sdf, cells)
    with torch.no_grad():
        extractor.tables["corners"].leaves["delta"].uniform_(-9, 9, generator=torch.Generator().manual_seed(2))
    extraction = extractor.extract(sdf, cells)
    check_extraction(extraction)
    place = unpack_ijk(extraction.cells)
    shift = (
        extraction.corner_positions[extraction.cell_corners[:, 0]] - grid.corner_positions(place, torch.float32)
    ).abs()
    shift = shift.detach()
    assert float(shift.max()) < 0.5 * grid.cell
    assert float(shift[grid.on_wall(place)].max()) == 0
    assert float(shift[~grid.on_wall(place)].mean()) > 0.3 * grid.cell


def test_learning_sharpens_the_edges_of_a_box():
    grid = grid_over_box(torch.ones(3), cells=14)
    sdf = box_sdf((0.5, 0.61, 0.43))
    extractor = FlexiCubesConfig(weight_rate=0.05, learn_deformation=True, deformation_rate=0.02).build(grid, CPU)
    cells = discover(sdf, grid, 0)
    errors = []
    for _ in range(60):
        extraction = extractor.extract(sdf, cells)
        corners = extraction.surface.vertices[extraction.surface.faces]
        inner = torch.cat([corners.mean(dim=1), 0.5 * (corners[:, 0] + corners[:, 1]), corners[:, 0]])
        error = sdf(inner).square().mean()
        errors.append(float(error.detach()))
        for table in extractor.tables.values():
            table.zero_grad()
        error.backward()
        for table in extractor.tables.values():
            table.step()
        cells = extraction.cells
    check_extraction(extraction)
    assert errors[-1] < 0.2 * errors[0]


def test_diagonal_leaves_the_larger_smallest_angle_and_does_not_fold():
    kite = torch.tensor([[0.0, 0, 0], [1, -0.2, 0], [2, 0, 0], [1, 0.2, 0]])
    dart = torch.tensor([[0.0, 0, 0], [2, 0.1, 0], [0, 1, 0], [0.5, 0.5, 0]])  # Reflex at its last corner.
    square = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1.001, 0], [0, 1, 0]])
    quads = torch.arange(12).reshape(3, 4)
    triangles, second = diagonal_split(torch.cat([kite, dart, square]), quads)
    assert second.tolist() == [True, True, False]
    assert triangles.tolist() == [
        [[0, 1, 3], [1, 2, 3]],
        [[4, 5, 7], [5, 6, 7]],
        [[8, 9, 10], [8, 10, 11]],
    ]


def single(tensor: Tensor) -> Tensor:
    return tensor.detach().float().requires_grad_()


@pytest.mark.parametrize("weighted", [True, False], ids=["weighted", "plain"])
@pytest.mark.parametrize("damped", [True, False], ids=["damped", "plain"])
def test_compiled_vertices_are_those_of_torch(weighted, damped):
    """Values and gradients, also of an edge with 0 at both ends and one that the surface grazes."""
    grid = unit_grid((4, 5, 4))
    band, topology = noisy_band(grid)
    values = band.corner_sdf.clone()
    values[topology.ends[0]] = torch.tensor([-0.0, 0.0], dtype=torch.float64)
    values[topology.ends[40]] *= 1e-4
    cells = len(band.cells)
    inputs = [band.corner_positions, values] + ([positive((cells, 8)), positive((cells, 12))] if weighted else [])
    random = torch.Generator().manual_seed(11)
    slopes = torch.randn(topology.vertex_count, 4, generator=random)
    most = torch.arange(4 * len(topology.ends))[torch.rand(4 * len(topology.ends), generator=random) < 0.9]
    for used in (None, most):
        found = []
        for way in (dual_vertices, dual_vertices_in_torch):
            leaves = [single(tensor) for tensor in inputs]
            positions, sdf, *weights = leaves
            alpha, beta = weights or (None, None)
            out = way(topology, positions, sdf, grid.cell, alpha, beta, used, damped)
            joined = torch.cat([out[0], out[1][:, None]], dim=1)
            (joined * slopes).nan_to_num(0.0).sum().backward()
            found.append([joined.detach(), *(leaf.grad for leaf in leaves)])
        # A vertex none of whose places is used has no position, in both.
        for mine, theirs in zip(*found, strict=True):
            torch.testing.assert_close(mine, theirs, rtol=2e-4, atol=2e-5, equal_nan=True)


def test_compiled_vertices_are_the_same_for_any_number_of_threads():
    grid = unit_grid((6, 6, 6))
    band, topology = noisy_band(grid)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            leaves = [single(band.corner_positions), single(band.corner_sdf), single(positive((len(band.cells), 8)))]
            vertices, deviation = dual_vertices(topology, *leaves[:2], grid.cell, leaves[2])
            (vertices.square().sum() + deviation.sum()).backward()
            found.append([vertices, deviation, *(leaf.grad for leaf in leaves)])
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(one, two) for one, two in zip(*found, strict=True))


def test_compiled_quads_are_those_of_torch():
    band, topology = noisy_band(unit_grid((6, 5, 7)))
    vertices = torch.arange(12 * len(band.cells)).reshape(-1, 12)
    compiled, plain = (way(band, vertices, 7) for way in (crossed_edges_compiled, crossed_edges_in_torch))
    for name in (each.name for each in fields(DualTopology)):
        mine, theirs = getattr(compiled, name), getattr(plain, name)
        assert mine == theirs == 7 if name == "vertex_count" else torch.equal(mine, theirs), name
    assert topology.descending.any()
    assert not topology.descending.all()


def test_compiled_diagonals_are_those_of_torch():
    random = torch.Generator().manual_seed(3)
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) + 0.5 * torch.randn(
        500, 4, 3, generator=random
    )
    corners[:3, 1] = corners[:3, 0]  # Coincident corners: an angle of 0.
    vertices, quads = corners.reshape(-1, 3), torch.arange(2000).reshape(-1, 4)
    second = diagonal_split(vertices, quads)[1]
    assert torch.equal(second, second_diagonals_in_torch(vertices, quads))
    assert 100 < int(second.sum()) < 400
