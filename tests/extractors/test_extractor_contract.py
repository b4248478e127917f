"""What every extractor promises, on shapes with known answers."""

import math

import pytest
import torch

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.geometry.band import children, discover
from sculpt_framework.geometry.grid import Grid, grid_over_box
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.geometry.topology import components, euler_characteristic, signed_volume
from sculpt_framework.testing import (
    box_sdf,
    check_extraction,
    check_extractor,
    kept_faces,
    sphere_sdf,
    torus_sdf,
    union_sdf,
)

CPU = torch.device("cpu")
DOUBLE_TORUS = union_sdf(torus_sdf(0.3, 0.12, (-0.36, 0.0, 0.0)), torus_sdf(0.3, 0.12, (0.36, 0.0, 0.0)))
TWO_SPHERES = union_sdf(sphere_sdf(0.3, (-0.45, 0.0, 0.1)), sphere_sdf(0.25, (0.5, 0.1, 0.0)))
SHAPES = {
    "sphere": (sphere_sdf(0.62), 1, 2),
    "torus": (torus_sdf(0.5, 0.2), 1, 0),
    "two-spheres": (TWO_SPHERES, 2, 4),
    "double-torus": (DOUBLE_TORUS, 1, -2),
    "box": (box_sdf((0.5, 0.61, 0.33)), 1, 2),
    "box-on-corners": (box_sdf((0.5, 0.5, 0.5)), 1, 2),
}


def grid_of(half_sides: tuple[float, float, float], cells: int, level: int = 0) -> Grid:
    return grid_over_box(torch.tensor(half_sides), cells=cells, level=level)


def test_extractor_keeps_the_contract(config: ExtractorConfig):
    check_extractor(config)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("half_sides", "cells"), [((1.0, 1.0, 1.0), 17), ((0.85, 0.7, 1.0), 32), ((1.0, 0.8, 0.7), 48)]
)
def test_shapes_have_their_topology(config: ExtractorConfig, shape: str, half_sides, cells):
    sdf, pieces, euler = SHAPES[shape]
    grid = grid_of(half_sides, cells)
    extraction = config.build(grid, CPU).extract(sdf, discover(sdf, grid, 0))
    check_extraction(extraction)
    faces = extraction.surface.faces
    assert components(faces)[0] == pieces
    assert euler_characteristic(faces) == euler
    assert signed_volume(extraction.surface.vertices, faces) > 0


def test_volume_converges_at_second_order(config: ExtractorConfig):
    sdf, exact = sphere_sdf(0.7), 4 / 3 * math.pi * 0.7**3
    errors = []
    for level in range(3):
        grid = grid_of((1.0, 1.0, 1.0), 14, level)
        surface = config.build(grid, CPU).extract(sdf, discover(sdf, grid, 0)).surface
        errors.append(abs(signed_volume(surface.vertices, surface.faces) - exact))
    assert errors[0] / errors[1] > 3.3
    assert errors[1] / errors[2] > 3.3


def test_surface_that_leaves_the_grid_is_closed_at_the_wall(config: ExtractorConfig):
    grid = grid_of((1.0, 1.0, 1.0), 20)
    for sdf in (sphere_sdf(0.5, (0.9, 0.2, -0.8)), sphere_sdf(1.5), box_sdf((0.3, 5.0, 0.4))):
        extraction = config.build(grid, CPU).extract(sdf, discover(sdf, grid, 0))
        check_extraction(extraction)
        assert components(extraction.surface.faces)[0] == 1


def test_no_surface_is_an_error(config: ExtractorConfig):
    grid = grid_of((1.0, 1.0, 1.0), 12)
    seeds = discover(sphere_sdf(0.5), grid, 0)
    for sdf in (sphere_sdf(-1.0), lambda points: torch.zeros_like(points[:, 0])):
        with pytest.raises(EmptySurfaceError):
            config.build(grid, CPU).extract(sdf, seeds)
    with pytest.raises(EmptySurfaceError):
        config.build(grid, CPU).extract(sphere_sdf(0.5), seeds[:0])


def test_sdf_that_is_not_finite_is_an_error(config: ExtractorConfig):
    grid = grid_of((1.0, 1.0, 1.0), 12)
    seeds = discover(sphere_sdf(0.5), grid, 0)
    with pytest.raises(FloatingPointError, match="not finite at 1 of"):
        config.build(grid, CPU).extract(
            lambda points: torch.where(torch.arange(len(points)) == 5, torch.nan, sphere_sdf(0.5)(points)), seeds
        )


def test_small_shift_keeps_most_faces_and_the_order_of_their_vertices(config: ExtractorConfig):
    grid = grid_of((1.0, 1.0, 1.0), 32)
    extractor = config.build(grid, CPU)
    before = extractor.extract(torus_sdf(0.5, 0.2), discover(torus_sdf(0.5, 0.2), grid, 0))
    after = extractor.extract(torus_sdf(0.5, 0.2 + 0.01 * grid.cell), before.cells)
    old, new = kept_faces(before.surface, after.surface)
    assert len(old) > 0.9 * len(before.surface.faces)
    moved = before.surface.vertices[before.surface.faces[old]] - after.surface.vertices[after.surface.faces[new]]
    assert moved.norm(dim=2).mean() < 0.03 * grid.cell


def test_turned_face_has_another_key(config: ExtractorConfig):
    grid = grid_of((1.0, 1.0, 1.0), 12)
    seeds = discover(lambda points: 0 * points[:, 0], grid, 0)
    sdf = sphere_sdf(0.6)
    ball = config.build(grid, CPU).extract(sdf, seeds).surface
    hole = config.build(grid, CPU).extract(lambda points: -sdf(points), seeds).surface
    assert not torch.isin(ball.face_keys, hole.face_keys).any()


def test_cells_follow_from_children_of_the_coarser_band(config: ExtractorConfig):
    sdf = torus_sdf(0.5, 0.2)
    extractor = config.build(grid_of((1.0, 1.0, 1.0), 16), CPU)
    cells = extractor.extract(sdf, discover(sdf, extractor.grid, 0)).cells
    extractor.set_grid(extractor.grid.at_level(1))
    refined = extractor.extract(sdf, children(cells))
    direct = config.build(extractor.grid, CPU).extract(sdf, discover(sdf, extractor.grid, 0))
    assert torch.equal(refined.cells, direct.cells)
    assert torch.equal(refined.surface.face_keys, direct.surface.face_keys)
    torch.testing.assert_close(refined.surface.vertices, direct.surface.vertices)
    with pytest.raises(ValueError, match="other levels"):
        extractor.extract(sdf, cells)


def test_another_box_is_refused(config: ExtractorConfig):
    extractor = config.build(grid_of((1.0, 1.0, 1.0), 16), CPU)
    with pytest.raises(ValueError, match="level"):
        extractor.set_grid(grid_of((1.0, 1.0, 0.5), 16))


def test_cost_follows_the_band_not_the_volume(config: ExtractorConfig):
    grid = grid_of((1.0, 1.0, 1.0), 12, level=9)  # 8192 cells per axis; the ball is 20 cells wide.
    sdf = sphere_sdf(10 * grid.cell, (0.301, -0.203, 0.105))
    extraction = config.build(grid, CPU).extract(sdf, discover(sdf, grid, 0))
    assert len(extraction.cells) < 5000
    check_extraction(extraction)


def test_double_precision(config: ExtractorConfig):
    torch.set_default_dtype(torch.float64)
    try:
        grid = grid_of((1.0, 1.0, 1.0), 12)
        extraction = config.build(grid, CPU).extract(sphere_sdf(0.6), discover(sphere_sdf(0.6), grid, 0))
        check_extraction(extraction)
        assert extraction.surface.vertices.dtype == torch.float64
    finally:
        torch.set_default_dtype(torch.float32)
