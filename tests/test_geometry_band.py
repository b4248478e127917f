"""The narrow band: keys, search and tracking."""

import math

import pytest
import torch
from torch import Tensor

from sculpt_framework.geometry.band import (
    FACE_CORNERS,
    LEAST_DROP,
    WALL_SDF,
    CornerSampler,
    cases_of,
    children,
    corners_of,
    crossing_weight,
    discover,
    levels_of,
    parents,
    track,
)
from sculpt_framework.geometry.grid import Grid, grid_over_box, pack, unpack_ijk
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.testing import box_sdf, sphere_sdf, torus_sdf, union_sdf


def cube_grid(cells: int, level: int = 0) -> Grid:
    return grid_over_box(torch.ones(3), cells=cells, level=level)


def all_cells(grid: Grid) -> Tensor:
    return pack(grid.level, torch.cartesian_prod(*(torch.arange(n) for n in grid.shape)))


def sampler(sdf, grid: Grid, log: list[Tensor] | None = None) -> CornerSampler:
    def sample(corners: Tensor) -> tuple[Tensor, Tensor]:
        if log is not None:
            log.append(corners)
        positions = grid.corner_positions(unpack_ijk(corners), torch.float64)
        return positions, sdf(positions)

    return sample


def test_faces_list_the_corners_on_each_side():
    assert FACE_CORNERS[0] == 0b01010101  # x = 0: corners 0, 2, 4, 6
    assert FACE_CORNERS[5] == 0b11110000  # z = 1: corners 4 to 7
    assert all(low + high == 255 for low, high in zip(FACE_CORNERS[::2], FACE_CORNERS[1::2], strict=True))


def test_cases_are_bits_of_the_inside_corners():
    inside = torch.zeros(1, 8, dtype=torch.bool)
    inside[0, [1, 6]] = True
    assert cases_of(inside).tolist() == [0b01000010]
    every = torch.arange(256)
    signs = (every[:, None] >> torch.arange(8) & 1).bool()
    assert torch.equal(cases_of(signs), every)
    # Also of rows that do not lie one after the other in memory.
    assert torch.equal(cases_of(signs.T.contiguous().T), every)
    assert cases_of(signs[:0]).tolist() == []


def test_children_fill_their_parents():
    cells = pack(3, torch.tensor([[0, 0, 0], [1, 2, 3], [7, 5, 6]]))
    refined = children(cells)
    assert len(refined.unique()) == 24
    assert bool((refined[1:] > refined[:-1]).all())
    assert bool((levels_of(refined) == 4).all())
    assert torch.equal(parents(refined).unique(), cells.sort().values)
    assert bool((parents(pack(0, torch.tensor([[1, 1, 1]]))) < 0).all())


def test_corners_are_shared():
    corners, rows = corners_of(pack(2, torch.tensor([[1, 1, 1], [2, 1, 1]])))
    assert len(corners) == 12
    assert torch.equal(rows[0, 1::2], rows[1, 0::2])
    assert unpack_ijk(corners[rows[1, 6]][None]).tolist() == [[2, 2, 2]]


@pytest.mark.parametrize("points_per_call", [100, 1 << 18])
def test_search_finds_every_cell_with_surface(points_per_call: int):
    shape = union_sdf(torus_sdf(0.5, 0.13), box_sdf((0.1, 0.15, 0.9)))
    grid = cube_grid(8, level=2)
    found = discover(shape, grid, 0, points_per_call=points_per_call)
    assert bool((found[1:] > found[:-1]).all())
    exact = track(sampler(shape, grid), grid, all_cells(grid)).cells
    assert torch.isin(exact, found).all()
    assert len(found) < 2 * len(exact)


def test_search_with_a_steeper_sdf_needs_its_lipschitz_constant():
    grid = cube_grid(8, level=2)
    exact = track(sampler(sphere_sdf(0.6), grid), grid, all_cells(grid)).cells

    def steep(points: Tensor) -> Tensor:
        return 4 * sphere_sdf(0.6)(points)

    assert not torch.isin(exact, discover(steep, grid, 0)).all()
    assert torch.isin(exact, discover(steep, grid, 0, lipschitz=4.0)).all()


def test_search_keeps_the_wall_where_it_is_inside():
    grid = cube_grid(6, level=1)
    shell = discover(lambda points: torch.full_like(points[:, 0], -9.0), grid, 0)
    n = grid.shape[0]
    assert len(shell) == n**3 - (n - 2) ** 3


def test_search_below_its_coarse_level_is_refused():
    with pytest.raises(ValueError, match="coarse_level 2"):
        discover(sphere_sdf(), cube_grid(8, level=1), 2)


@pytest.mark.parametrize("seed_count", [1, 7, None])
def test_tracking_closes_the_band_and_samples_each_corner_once(seed_count: int | None):
    shape, grid, log = torus_sdf(), cube_grid(24), []
    expected = track(sampler(shape, grid), grid, all_cells(grid))
    band = track(sampler(shape, grid, log), grid, expected.cells[:seed_count])
    sampled = torch.cat(log)
    assert len(sampled.unique()) == len(sampled)
    for name in ("cells", "cases", "corners", "cell_corners", "cell_at_corner", "corner_positions", "corner_sdf"):
        assert torch.equal(getattr(band, name), getattr(expected, name)), name


@pytest.mark.parametrize("moved", [0.0, 0.01, 0.1, 0.5])
def test_an_earlier_band_changes_nothing_but_what_is_looked_up(moved: float):
    """However far the surface has moved since: cells that were crossed may have split it, or lost it."""
    shape, grid, log = torus_sdf(), cube_grid(24), []
    before = track(sampler(shape, grid), grid, all_cells(grid)).detach()

    def now(points: Tensor) -> Tensor:
        return torch.minimum(shape(points + points.new_tensor([moved, 0.3 * moved, 0.0])), shape(points) + 3.0 * moved)

    expected = track(sampler(now, grid), grid, before.cells)
    band = track(sampler(now, grid, log), grid, before.cells, before)
    sampled = torch.cat(log)
    assert len(sampled.unique()) == len(sampled)
    for name in ("cells", "cases", "corners", "cell_corners", "cell_at_corner", "corner_positions", "corner_sdf"):
        assert torch.equal(getattr(band, name), getattr(expected, name)), name
    # One of other cells is not used.
    other = track(sampler(now, grid), grid, before.cells[:5], before)
    assert torch.equal(other.cells, track(sampler(now, grid), grid, before.cells[:5]).cells)


def test_band_is_consistent():
    grid = cube_grid(20)
    band = track(sampler(torus_sdf(), grid), grid, discover(torus_sdf(), grid, 0))
    assert torch.equal(band.corners[band.cell_corners[:, 0]], band.cells)
    assert torch.equal(cases_of(band.corner_sdf[band.cell_corners] < 0), band.cases)
    assert len(band.cell_corners.unique()) == len(band.corners)
    assert bool(((band.cases > 0) & (band.cases < 255)).all())
    rows = torch.arange(len(band.cells))
    assert torch.equal(band.neighbour(rows, 0), rows)
    there = band.neighbour(rows, 2)
    assert torch.equal(
        unpack_ijk(band.cells[there[there >= 0]]), unpack_ijk(band.cells[there >= 0]) + torch.tensor([0, 1, 0])
    )


def test_tracking_stays_on_the_component_of_its_seeds():
    pair = union_sdf(sphere_sdf(0.3, (-0.5, 0.0, 0.0)), sphere_sdf(0.3, (0.5, 0.0, 0.0)))
    grid = cube_grid(20)
    band = track(sampler(pair, grid), grid, pack(0, grid.cells_at(torch.tensor([[-0.2, 0.0, 0.0], [0.0, 0.9, 0.0]]))))
    assert float(band.corner_positions[:, 0].max()) < 0.0


def test_zero_is_outside_and_the_wall_is_raised():
    grid = Grid(origin=(0.0, 0.0, 0.0), base_shape=(3, 3, 3), base_cell=2.0)
    nothing = track_value(grid, 0.0)
    assert nothing is None
    band = track_value(grid, -1.0)
    assert band is not None
    wall = grid.on_wall(unpack_ijk(band.corners))
    assert bool((band.corner_sdf[wall] == WALL_SDF * 2.0).all())
    assert bool((band.corner_sdf[~wall] == -1.0).all())


def track_value(grid: Grid, value: float):
    try:
        return track(sampler(lambda points: torch.full_like(points[:, 0], value), grid), grid, all_cells(grid))
    except EmptySurfaceError:
        return None


def test_gradient_reaches_the_samples():
    radius = torch.tensor(0.6, dtype=torch.float64, requires_grad=True)
    grid = cube_grid(12)

    def sdf(points: Tensor) -> Tensor:
        return sphere_sdf(0.0)(points) - radius

    band = track(sampler(sdf, grid), grid, discover(sphere_sdf(0.6), grid, 0))
    (slope,) = torch.autograd.grad(band.corner_sdf.sum(), [radius])
    assert slope == -len(band.corners)


def test_crossing_weight_is_exact_and_its_gradient_bounded():
    inner = torch.tensor([1.0, 3.0, 0.5, 1e-9, 0.0], dtype=torch.float64, requires_grad=True)
    outer = torch.tensor([1.0, 1.0, 0.0, 1e-9, 0.0], dtype=torch.float64, requires_grad=True)
    weight = crossing_weight(inner, outer, LEAST_DROP)
    assert weight.tolist() == [0.5, 0.75, 1.0, 0.5, 0.5]
    slopes = torch.autograd.grad(weight.sum(), [inner, outer])
    assert all(bool((slope.abs() <= 1 / LEAST_DROP).all()) for slope in slopes)


def test_crossing_weight_gradient():
    values = torch.tensor([[0.2, 0.7], [1e-4, 3e-4], [1e-4, 5.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda v: crossing_weight(v[:, 0], v[:, 1], LEAST_DROP), [values], eps=1e-7, rtol=1e-5, atol=1e-4
    )


def test_a_damped_crossing_stays_where_it_is_and_moves_less():
    ends = torch.tensor([[0.2, 0.7], [0.2, 0.2], [1e-5, 3e-5], [0.0, 0.0]], dtype=torch.float64, requires_grad=True)
    exact = crossing_weight(ends[:, 0], ends[:, 1], LEAST_DROP)
    damped = crossing_weight(ends[:, 0], ends[:, 1], LEAST_DROP, damped_below=0.8)
    assert torch.equal(exact, damped)
    (full,) = torch.autograd.grad(exact.sum(), [ends])
    (less,) = torch.autograd.grad(damped.sum(), [ends])
    torch.testing.assert_close(less, full * (ends.detach().sum(dim=1, keepdim=True) / 0.8).clamp(max=1.0))
    assert torch.equal(less[0], full[0])
    assert bool((less.abs() <= 1 / 0.8).all())


def test_crossing_weight_turns_continuously_towards_the_middle():
    below, above = (crossing_weight(torch.tensor(f * 0.8e-3), torch.tensor(f * 0.2e-3), 1e-3) for f in (0.9999, 1.0001))
    assert math.isclose(float(below), float(above), abs_tol=1e-4)
