"""What PGSR learns from: planes' depths, normals, and how planes match other views."""

import math
from dataclasses import replace

import pytest
import torch
from scipy.special import lambertw
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.losses import TrainingImage
from sculpt_framework.rendering.depth_normals import normals_of_depths, pixel_rays
from sculpt_framework.stress.small import small_scene
from sculpt_framework.types import Camera
from sculpt_plugins.methods.pgsr.drawing import single_view
from sculpt_plugins.methods.pgsr.planes import PlaneMaps, correlation, depths_of, match_planes
from tests.learning import beginning_of

SIZE = 48


def camera(x: float) -> Camera:
    """Beside the origin, looking along z."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[0, 3] = -x
    return Camera(world_to_camera=pose, fx=60.0, fy=60.0, cx=SIZE / 2, cy=SIZE / 2, width=SIZE, height=SIZE)


def plane(normal: torch.Tensor, distance: float) -> PlaneMaps:
    full = torch.ones(SIZE, SIZE, dtype=torch.bool)
    return PlaneMaps(
        normal=normal.double().expand(SIZE, SIZE, 3), distance=torch.full((SIZE, SIZE), distance).double(), covered=full
    )


def photograph(at: Camera, depth: torch.Tensor, name: str) -> TrainingImage:
    """Of a pattern that is painted on the world's x and y."""
    points = pixel_rays(at, depth) * depth[..., None] + at.position
    grey = 0.5 + 0.2 * torch.sin(14 * points[..., 0]) * torch.cos(11 * points[..., 1])
    return TrainingImage(
        name=name, camera=at, premultiplied=grey[..., None].expand(-1, -1, 3), alpha=torch.ones(SIZE, SIZE)
    )


SLANTED = torch.tensor([0.3, 0.0, -math.sqrt(1 - 0.09)], dtype=torch.float64)


def test_depths_and_normals_of_a_slanted_plane():
    maps, at = plane(SLANTED, -2.0), camera(0.0)
    depth = depths_of(maps, at)
    points = pixel_rays(at, depth) * depth[..., None]
    assert torch.allclose(points @ SLANTED, torch.full((SIZE, SIZE), -2.0, dtype=torch.float64))
    normals, counts = normals_of_depths(depth, maps.covered, at)
    assert counts.all()
    assert torch.allclose(normals, SLANTED.expand(SIZE - 2, SIZE - 2, 3), atol=1e-9)
    assert float(single_view(maps, at, torch.rand(SIZE, SIZE, 3).double())) == pytest.approx(0, abs=1e-9)
    # Edge on, and behind: no depth.
    assert float(depths_of(plane(torch.tensor([1.0, 0, 0]), -2.0), at).abs().max()) < 1e4
    assert float(depths_of(plane(-SLANTED, 2.0), at).abs().max()) == 0


def test_a_true_plane_matches_and_a_wrong_one_does_not():
    first, second = camera(0.0), camera(0.25)
    maps = plane(SLANTED, -2.0)
    # The same plane, from the second camera.
    moved = plane(SLANTED, -2.0 - 0.25 * 0.3)
    images = [photograph(first, depths_of(maps, first), "a"), photograph(second, depths_of(moved, second), "b")]
    random = torch.Generator().manual_seed(0)
    true = match_planes(maps, images[0], moved, images[1], 400, random)
    assert float(true.missed) < 1e-3
    assert float(true.unlike) < 2e-3
    off = match_planes(plane(SLANTED, -1.9), images[0], plane(SLANTED, -1.9 - 0.075), images[1], 400, random)
    assert float(off.missed) < 1e-3
    assert float(off.unlike) > 3 * float(true.unlike)
    apart = match_planes(plane(SLANTED, -1.98), images[0], moved, images[1], 400, random)
    assert float(apart.missed) > 0.02
    hidden = match_planes(plane(SLANTED, -1.0), images[0], moved, images[1], 400, random)
    assert float(hidden.missed) == 0
    nothing = match_planes(replace(maps, covered=~maps.covered), images[0], moved, images[1], 400, random)
    assert float(nothing.unlike) == 0


def test_slopes_of_the_match():
    first, second = camera(0.0), camera(0.25)
    moved = plane(SLANTED, -2.075)
    truth = plane(SLANTED, -2.0)
    images = [photograph(first, depths_of(truth, first), "a"), photograph(second, depths_of(moved, second), "b")]
    covered = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    covered[24, 24] = True
    small = torch.tensor([0.31, 0.02, -0.95, -1.99], dtype=torch.float64, requires_grad=True)

    def value(given: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        maps = PlaneMaps(normal=given[:3].expand(SIZE, SIZE, 3), distance=given[3].expand(SIZE, SIZE), covered=covered)
        match = match_planes(maps, images[0], moved, images[1], 3, torch.Generator().manual_seed(1))
        return match.unlike, match.missed

    def parts(given: torch.Tensor) -> tuple[float, float]:
        """Pixels missed and 1 - NCC of the one place: of w m and w (1 - NCC), with w = exp(-m), and m below 1."""
        unlike, weighted = value(given)
        missed = -float(lambertw(-float(weighted)).real)
        return missed, float(unlike) * math.exp(missed)

    # The weight is not differentiated.
    unlike, missed = value(small)
    weight = math.exp(-parts(small.detach())[0])
    slopes = [torch.autograd.grad(found, small, retain_graph=True)[0] for found in (missed, unlike)]
    for place in range(4):
        step = torch.zeros(4, dtype=torch.float64)
        step[place] = 1e-6
        ends = zip(parts(small.detach() + step), parts(small.detach() - step), strict=True)
        for slope, (above, below) in zip(slopes, ends, strict=True):
            assert float(slope[place]) == pytest.approx(weight * (above - below) / 2e-6, rel=1e-4, abs=1e-6)


def test_slopes_of_depths_and_of_the_single_view():
    at = replace(camera(0.0), cx=3.0, cy=3.0, width=6, height=6)
    random = torch.Generator().manual_seed(3)
    normal = SLANTED + 0.1 * torch.rand(6, 6, 3, dtype=torch.float64, generator=random)
    distance = -2 + 0.1 * torch.rand(6, 6, dtype=torch.float64, generator=random)
    rgb = torch.rand(6, 6, 3, dtype=torch.float64, generator=random)

    def maps(normals: torch.Tensor, distances: torch.Tensor) -> PlaneMaps:
        return PlaneMaps(normal=normals, distance=distances, covered=torch.ones(6, 6, dtype=torch.bool))

    inputs = normal.requires_grad_(), distance.requires_grad_()
    assert gradcheck(lambda *given: depths_of(maps(*given), at), inputs)
    assert gradcheck(lambda *given: single_view(maps(*given), at, rgb), inputs)


def test_slopes_of_the_correlation():
    patches = torch.rand(4, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    assert gradcheck(lambda own: correlation(own, patches.flip(0)), (patches.clone().requires_grad_(),))
    even = torch.full((1, 9), 0.5, dtype=torch.float64, requires_grad=True)
    found = correlation(even, patches[:1])
    found.sum().backward()
    assert float(found.detach()) == 1
    assert even.grad is not None
    assert float(even.grad.abs().max()) == 0


@pytest.mark.slow
def test_it_learns():
    config = sculpt.methods["pgsr"]()
    assert isinstance(config, FreeGaussiansConfig)
    small = replace(config, steps=150, gaussians=600, mesh_cells=32, density=replace(config.density, every=10))
    session = sculpt.Session(small_scene(), replace(small, holdout_every=4))
    first = beginning_of(session)
    reports = list(session)
    assert {"color", "flatness", "single view", "geometric", "photometric"} <= set(reports[-1].terms)
    assert session.curve[-1]["psnr"] > first["psnr"] + 3
    assert session.mesh().to_trimesh().is_watertight
