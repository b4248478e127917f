"""The bound on how far a step moves the surface."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from small_runs import FIELDS, small_config, train
from torch import Tensor, nn

from sculpt_framework.extractors import Extraction
from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.sculpting.trust_region import TrustRegion, motion, probed
from sculpt_framework.types import Scene
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig

CELLS = 12


class Ball:
    """Distance to a sphere, times a factor, by its radius; not linear in its parameter where that is bent."""

    def __init__(self, *, slope: float = 1.0, bend: Callable[[Tensor], Tensor] = lambda raw: raw):
        self.raw = nn.Parameter(torch.zeros(1))
        self._slope, self._bend = slope, bend

    def __call__(self, points: Tensor) -> Tensor:
        return self._slope * (points.norm(dim=1) - 0.6 - self._bend(self.raw))


@pytest.fixture
def sphere_of() -> Callable[[Ball], Extraction]:
    grid = grid_over_box(torch.ones(3), cells=CELLS, level=0)

    def extract(ball: Ball) -> Extraction:
        seeds = discover(Ball(), grid, coarse_level=0, lipschitz=1.5)
        return FlexiCubesConfig().build(grid, torch.device("cpu")).extract(ball, seeds)

    return extract


def taken(ball: Ball, extraction: Extraction, by: float, cells: float, rate: float = 1.0) -> tuple[float, float]:
    """The share that is kept of a step of the radius, and how far the surface has moved then, in cells."""
    region = TrustRegion(cells, [ball.raw])
    before = region.look(extraction, ball)
    assert before is not None
    with torch.no_grad():
        ball.raw.add_(by)
    return region.shorten(before, ball, rate), motion(before, ball)


@pytest.mark.parametrize("slope", [0.2, 1.0, 30.0])
def test_motion_is_measured_in_cells(sphere_of: Callable[[Ball], Extraction], slope: float):
    ball = Ball(slope=slope)
    side = 2.0 / CELLS
    share, moved = taken(ball, sphere_of(ball), by=0.5 * side, cells=100.0)
    assert share == 1.0
    # The mean slope over a cell at a sphere is a little less than that on its radius.
    assert moved == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("rate", [1.0, 0.1])
def test_a_step_that_goes_too_far_is_shortened(sphere_of: Callable[[Ball], Extraction], rate: float):
    ball = Ball()
    share, moved = taken(ball, sphere_of(ball), by=2.0 * (2.0 / CELLS), cells=0.25, rate=rate)
    assert moved == pytest.approx(0.25 * rate, rel=0.01)
    assert float(ball.raw.detach()) == pytest.approx(share * 4.0 / CELLS, rel=1e-4)


def test_so_is_one_of_a_field_that_is_not_linear(sphere_of: Callable[[Ball], Extraction]):
    ball = Ball(bend=lambda raw: 0.3 * torch.sin(raw))
    _, moved = taken(ball, sphere_of(ball), by=1.5, cells=0.2)
    assert moved <= 1.06 * 0.2
    assert moved > 0.1


def test_a_shorter_step_stays_to_the_bit(sphere_of: Callable[[Ball], Extraction]):
    ball = Ball()
    share, _ = taken(ball, sphere_of(ball), by=0.01, cells=1.0)
    assert share == 1.0
    assert float(ball.raw.detach()) == torch.tensor(0.01)


def test_a_field_that_is_not_finite_is_left_to_its_owner(sphere_of: Callable[[Ball], Extraction]):
    ball = Ball()
    share, _ = taken(ball, sphere_of(ball), by=math.nan, cells=0.1)
    assert share == 1.0
    assert bool(ball.raw.isnan())


def test_no_bound_no_look(sphere_of: Callable[[Ball], Extraction]):
    ball = Ball()
    region = TrustRegion(0.0, [ball.raw])
    before = region.look(sphere_of(ball), ball)
    assert before is None
    assert region.shorten(before, ball, 1.0) == 1.0


def test_the_wall_of_the_grid_is_no_motion():
    """A surface that is cut off there: the extraction raises the distance, the field knows nothing of it."""
    grid = grid_over_box(torch.ones(3), cells=CELLS, level=0)

    def sdf(points: Tensor) -> Tensor:
        return points.norm(dim=1) - 1.5

    seeds = discover(sdf, grid, coarse_level=0, lipschitz=1.5)
    extraction = FlexiCubesConfig().build(grid, torch.device("cpu")).extract(sdf, seeds)
    points, values, per_cell = probed(extraction, sdf)
    lowest = float(extraction.corner_sdf[extraction.corner_positions.abs().amax(dim=1) > 1.33].min())
    assert lowest > 0.0 > float(values.min())
    torch.testing.assert_close(values, sdf(points))
    assert float(per_cell.min()) > 0.5 * grid.cell


def test_a_run_at_a_thousand_times_the_rate_stays_on_the_object(scene: Scene):
    """Its first step alone would move the surface by many cells."""
    fast = replace(FIELDS["hash-grid"], rate=2.0)
    config = small_config(field=fast, steps=4, trust_cells=0.1)
    bounded = train(config, scene)
    shares = [event.data["step_kept"] for event in bounded.of("outer_step")]
    assert all(0.0 < share < 0.1 for share in shares)
    assert not bounded.of("recovered")
    free = train(replace(config, trainer=replace(config.trainer, trust_cells=0.0)), scene)
    assert {event.data["step_kept"] for event in free.of("outer_step")} == {1.0}
    assert bounded.losses[-1] < 0.8 * free.losses[-1]
