"""What stretches of rays hide: kernels against torch, known answers, gradients."""

import pytest
import torch
from torch.autograd import gradcheck

from sculpt_framework.volume_rendering.stretches import (
    OccupiedCells,
    Rays,
    Stretches,
    side_by_side,
    stretches_around,
    stretches_of,
)
from sculpt_framework.volume_rendering.weights import add_up, weigh, weigh_in_torch


def stretches(counts: list[int]) -> Stretches:
    number = torch.tensor(counts)
    ray = torch.repeat_interleave(torch.arange(len(counts)), number)
    offsets = torch.cat([number.new_zeros(1), number.cumsum(0)])
    return Stretches(ray=ray, begin=torch.zeros(len(ray)), length=torch.ones(len(ray)), offsets=offsets)


def rays_at_random(count: int, dtype: torch.dtype) -> Rays:
    random = torch.Generator().manual_seed(3)
    origins = torch.randn(count, 3, generator=random, dtype=dtype)
    origins = 3 * origins / origins.norm(dim=1, keepdim=True)
    aims = 0.8 * torch.randn(count, 3, generator=random, dtype=dtype) - origins
    return Rays(origins=origins, directions=aims / aims.norm(dim=1, keepdim=True))


def test_weights_and_what_is_left_are_all_there_is():
    where = stretches([3, 0, 5, 1])
    alphas = torch.rand(9, generator=torch.Generator().manual_seed(0))
    weights, through = weigh(alphas, where)
    assert torch.allclose(add_up(weights, torch.ones(9, 1), where.offsets)[:, 0], 1 - through, atol=1e-6)
    assert through[1] == 1
    by_hand = torch.stack([alphas[0], alphas[1] * (1 - alphas[0]), alphas[2] * (1 - alphas[0]) * (1 - alphas[1])])
    assert torch.allclose(weights[:3], by_hand)


@pytest.mark.parametrize("opaque", [False, True])
def test_the_kernels_do_what_torch_does(opaque: bool):
    where = stretches([4, 0, 1, 7])
    alphas = torch.rand(12, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    if opaque:
        alphas[[1, 6]], alphas[[2, 9]] = 1.0, 0.0
    to = torch.rand(16, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    found = []
    for function in (weigh, weigh_in_torch):
        given = alphas.clone().requires_grad_()
        weights, through = function(given, where)
        (torch.cat([weights, through]) * to).sum().backward()
        assert given.grad is not None
        found.append((weights.detach(), through.detach(), given.grad))
    for compiled, plain in zip(*found, strict=True):
        assert torch.allclose(compiled, plain, atol=1e-14)


def test_the_slope_is_right():
    where = stretches([3, 0, 2])
    alphas = torch.tensor([0.2, 1.0, 0.4, 0.0, 0.9], dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda given: weigh(given, where), (alphas,))
    values = torch.rand(5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(4)).requires_grad_()
    weights = torch.rand(5, dtype=torch.float64, generator=torch.Generator().manual_seed(5)).requires_grad_()
    assert gradcheck(lambda given, of: add_up(given, of, where.offsets), (weights, values))


def test_stretches_of_a_box_that_is_full():
    rays = Rays(
        origins=torch.tensor([[-3.0, 0.1, 0.1], [-3.0, 5.0, 0.0], [0.0, 0.1, 0.1]]),
        directions=torch.tensor([[1.0, 0.0, 0.0]] * 3),
    )
    full = OccupiedCells(occupied=torch.ones(4, 4, 4, dtype=torch.bool), low=(-1.0, -1.0, -1.0), cell=0.5)
    found = stretches_of(rays, full, 0.25)
    # Through the box, beside it, and from its middle.
    assert found.offsets.diff().tolist() == [8, 0, 4]
    assert torch.allclose(found.begin[:8], 2 + 0.25 * torch.arange(8))
    assert torch.allclose(found.points(rays, 0.5)[8:, 0], 0.125 + 0.25 * torch.arange(4))
    assert found.goes_on.tolist() == [True] * 7 + [False] + [True] * 3 + [False]
    moved = stretches_of(rays, full, 0.25, torch.tensor([0.5, 0.5, 0.5]))
    assert torch.allclose(moved.begin[:8], 2.125 + 0.25 * torch.arange(8))


def test_empty_cells_are_passed_over():
    occupied = torch.zeros(4, 4, 4, dtype=torch.bool)
    occupied[1, 2, 2] = occupied[3, 2, 2] = True
    cells = OccupiedCells(occupied=occupied, low=(-1.0, -1.0, -1.0), cell=0.5)
    rays = Rays(origins=torch.tensor([[-3.0, 0.1, 0.1]]), directions=torch.tensor([[1.0, 0.0, 0.0]]))
    found = stretches_of(rays, cells, 0.25)
    assert torch.allclose(found.begin, torch.tensor([2.5, 2.75, 3.5, 3.75]))
    assert found.goes_on.tolist() == [True, False, True, False]
    none = OccupiedCells(occupied=torch.zeros(4, 4, 4, dtype=torch.bool), low=cells.low, cell=0.5)
    assert len(stretches_of(rays, none, 0.25)) == 0


def test_the_compiled_march_is_that_of_torch():
    occupied = torch.rand(6, 5, 7, generator=torch.Generator().manual_seed(6)) > 0.6
    cells = OccupiedCells(occupied=occupied, low=(-1.0, -0.8, -1.1), cell=0.31)
    rays = rays_at_random(200, torch.float64)
    exact = stretches_of(rays, cells, 0.07)
    single = Rays(origins=rays.origins.float(), directions=rays.directions.float())
    compiled = stretches_of(single, cells, 0.07)
    # A middle on the wall of a cell may be told to be on either side of it.
    differ = (exact.offsets.diff() != compiled.offsets.diff()).float().mean()
    assert differ < 0.02
    assert abs(len(exact) - len(compiled)) <= 4
    assert len(exact) > 1000


def test_stretches_around_a_depth_and_beside_others():
    rays = rays_at_random(4, torch.float32)
    middles, reach = torch.tensor([2.0, 3.0, 0.1, 2.0]), torch.tensor([0.4, 0.0, 0.4, 0.2])
    around = stretches_around(rays, middles, reach, 8, torch.tensor([0.0, 0.0, 0.0, 0.5]))
    assert around.offsets.tolist() == [0, 8, 8, 16, 24]
    assert around.begin[[0, 7]].tolist() == pytest.approx([1.6, 2.3])
    # None begins behind the camera; the last is half a stretch further on.
    assert around.begin[8] == 0
    assert float(around.begin[16]) == pytest.approx(1.8 + 0.025)
    assert around.goes_on.tolist() == 3 * ([True] * 7 + [False])
    assert float((around.middle[1:8] - around.middle[:7]).min()) == pytest.approx(0.1, rel=1e-4)
    full = OccupiedCells(occupied=torch.ones(2, 2, 2, dtype=torch.bool), low=(-1.0, -1.0, -1.0), cell=1.0)
    everywhere = stretches_of(rays, full, 0.25)
    left = everywhere.but_of(reach > 0)
    assert left.ray.tolist() == everywhere.ray[everywhere.ray == 1].tolist()
    both = side_by_side(around, left)
    assert both.offsets.diff().tolist() == [8, len(left), 8, 8]
    assert torch.equal(both.ray, both.ray.sort().values)
    assert torch.equal(both.begin[both.ray == 3], around.begin[around.ray == 3])
    nothing = stretches_around(rays, middles, torch.zeros(4), 8, torch.zeros(4))
    assert len(nothing) == 0
    assert nothing.offsets.tolist() == [0] * 5
