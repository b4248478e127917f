"""Relightable 3D Gaussian: what light makes of a material, what each Gaussian learns besides, a run's whole life."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.export.mesh_files import srgb_to_linear
from sculpt_framework.free_gaussians.config import DensityConfig, GaussianRates
from sculpt_framework.free_gaussians.splats import Splats
from sculpt_framework.reconstructor import Moment
from sculpt_framework.rendering.depth_normals import pixel_rays
from sculpt_framework.rendering.spherical_harmonics import spherical_harmonics
from sculpt_framework.stress.small import small_scene
from sculpt_framework.types import Camera
from sculpt_plugins.methods.relightable.config import RelightableConfig
from sculpt_plugins.methods.relightable.drawing import RelightableDrawing, mean_and_variance, normal_difference
from sculpt_plugins.methods.relightable.shading import encode_srgb, shade, unit
from tests.learning import beginning_of

F64 = torch.float64


def method() -> RelightableConfig:
    config = sculpt.methods["relightable"]()
    assert isinstance(config, RelightableConfig)
    return config


def small(steps: int) -> RelightableConfig:
    config = method()
    return replace(config, steps=steps, gaussians=600, mesh_cells=32, density=replace(config.density, every=10))


def at_random(*shape: int, seed: int) -> torch.Tensor:
    return torch.randn(*shape, dtype=F64, generator=torch.Generator().manual_seed(seed))


def directions(count: int, seed: int) -> torch.Tensor:
    return unit(at_random(count, 3, seed=seed))


def sphere(count: int) -> torch.Tensor:
    """Directions spread evenly: a spiral of golden angles."""
    k = torch.arange(count, dtype=F64)
    z, turn = 1 - (2 * k + 1) / count, k * math.pi * (3 - math.sqrt(5))
    across = (1 - z.square()).sqrt()
    return torch.stack([across * turn.cos(), across * turn.sin(), z], dim=1)


def light_at_random(seed: int) -> torch.Tensor:
    """Brighter than 0 from everywhere."""
    light = 0.1 * at_random(16, 3, seed=seed)
    light[0] = 2 * math.sqrt(math.pi)
    return light


# -- light and materials -------------------------------------------------------------------------------------------


def test_matter_is_as_bright_as_the_light_that_falls_on_it():
    light, normals, towards = light_at_random(0), directions(5, 1), directions(5, 2)
    incoming = sphere(20_000)
    radiance = spherical_harmonics(incoming, 3) @ light
    cosines = (normals @ incoming.T).clamp(min=0)
    irradiance = cosines @ radiance * (4 * math.pi / len(incoming))
    albedo, rough, half = (
        torch.full((5, 3), 0.6, dtype=F64),
        torch.full((5,), 0.7, dtype=F64),
        torch.full((5,), 0.5).double(),
    )
    diffuse = shade(normals, towards, albedo, rough, half, light) - shade(
        normals, towards, 0 * albedo, rough, half, light
    )
    assert torch.allclose(diffuse, 0.5 * 0.6 / math.pi * irradiance, rtol=1e-3)


def test_what_shines_shows_the_light_where_it_comes_from():
    light, normals = light_at_random(3), directions(4, 4)
    black, smooth, ones = torch.zeros(4, 3, dtype=F64), torch.zeros(4, dtype=F64), torch.ones(4, dtype=F64)
    # Looked at straight on, a smooth dielectric mirrors four hundredths of what comes along the normal.
    straight = shade(normals, normals, black, smooth, ones, light)
    assert torch.allclose(straight, 0.04 * spherical_harmonics(normals, 3) @ light, rtol=0.15)
    # From aside, it is the mirrored direction that counts, and more of it.
    towards = unit(normals + 2.0 * unit(torch.linalg.cross(normals, directions(4, 5))))
    mirrored = 2 * (normals * towards).sum(1, keepdim=True) * normals - towards
    aside = shade(normals, towards, black, smooth, ones, light)
    share = aside / (spherical_harmonics(mirrored, 3) @ light)
    assert torch.allclose(share, share[:, :1].expand(-1, 3), rtol=1e-9)
    assert (share > 1.5 * straight / (spherical_harmonics(normals, 3) @ light)).all()
    # What is rough blurs the light until its mean is left.
    rough = shade(normals, normals, black, ones, ones, light)
    even = shade(normals, normals, black, ones, ones, torch.cat([light[:1], torch.zeros(15, 3, dtype=F64)]))
    smoother = shade(normals, normals, black, 0.3 * ones, ones, light)
    assert float((rough / even - 1).abs().max()) < 0.5 * float((smoother / smoother.mean() - 1).abs().max())


def test_slopes_of_shading():
    light, normals, towards = light_at_random(6), directions(3, 7), directions(3, 7)
    towards = unit(towards + 0.4 * directions(3, 8))
    given = (normals, towards, 0.5 * torch.ones(3, 3, dtype=F64), torch.tensor([0.2, 0.5, 0.9], dtype=F64))
    inputs = tuple(each.clone().requires_grad_() for each in (*given, 0.8 * torch.ones(3, dtype=F64), light))
    assert gradcheck(shade, inputs)


def test_shading_where_there_is_no_direction_and_no_light():
    light = light_at_random(9).requires_grad_()
    nowhere = torch.zeros(1, 3, dtype=F64, requires_grad=True)
    one, grey = torch.ones(1, dtype=F64), torch.full((1, 3), 0.5, dtype=F64)
    found = shade(nowhere, nowhere, grey, one, one, light)
    found.sum().backward()
    assert torch.isfinite(found).all()
    assert nowhere.grad is not None
    assert torch.isfinite(nowhere.grad).all()
    dark = shade(directions(1, 0), directions(1, 0), grey, one, one, -light_at_random(9))
    assert float(dark.abs().max()) == 0


def test_the_curve_of_srgb_and_its_slopes():
    linear = torch.tensor([0.0, 0.001, 0.0031308, 0.02, 0.5, 1.0, 3.0], dtype=F64, requires_grad=True)
    encoded = encode_srgb(linear)
    back = srgb_to_linear(encoded.detach().numpy()[:6].reshape(2, 3))
    assert np.allclose(back.reshape(-1), linear.detach().numpy()[:6], atol=1e-6)
    encoded.sum().backward()
    assert linear.grad is not None
    assert float(linear.grad[0]) == pytest.approx(12.92)
    assert gradcheck(encode_srgb, (torch.tensor([0.001, 0.02, 0.5], dtype=F64, requires_grad=True),))


def test_unit_vectors_and_none():
    vectors = torch.tensor([[3.0, 0, 4], [0, 0, 0]], dtype=F64, requires_grad=True)
    found = unit(vectors)
    assert found.tolist() == [[pytest.approx(0.6), 0, pytest.approx(0.8)], [0, 0, 0]]
    found.sum().backward()
    assert vectors.grad is not None
    assert vectors.grad[1].tolist() == [0, 0, 0]
    assert gradcheck(unit, (at_random(3, 3, seed=1).requires_grad_(),))


# -- depths and normals --------------------------------------------------------------------------------------------


def test_normals_of_a_slanted_plane_agree_in_the_frame_of_the_gaussians():
    turn = torch.tensor([[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1]], dtype=F64)
    at = Camera(world_to_camera=turn, fx=40.0, fy=40.0, cx=8.0, cy=8.0, width=16, height=16)
    local = torch.tensor([0.3, 0.0, -math.sqrt(1 - 0.09)], dtype=F64)
    depth = -2.0 / (pixel_rays(at, turn) @ local)
    normal = (turn[:3, :3].T @ local).expand(16, 16, 3)
    assert float(normal_difference(normal, depth, at)) == pytest.approx(0, abs=1e-12)
    assert float(normal_difference(-normal, depth, at)) == pytest.approx(4 / 3, rel=1e-6)
    assert float(normal_difference(normal, 0 * depth, at)) == 0
    few = Camera(world_to_camera=turn, fx=40.0, fy=40.0, cx=2.0, cy=2.0, width=4, height=4)
    inputs = (normal[:4, :4] + 0.1 * at_random(4, 4, 3, seed=2), depth[:4, :4] + 0.01 * at_random(4, 4, seed=3))
    assert gradcheck(lambda n, d: normal_difference(n, d, few), tuple(each.requires_grad_() for each in inputs))


def test_mean_and_variance():
    # Half of the weight at depth 2, a quarter at 3; and a pixel of nothing.
    alpha = torch.tensor([0.75, 0.0], dtype=F64, requires_grad=True)
    total = torch.tensor([1.75, 0.0], dtype=F64, requires_grad=True)
    squares = torch.tensor([4.25, 0.0], dtype=F64, requires_grad=True)
    covered = torch.tensor([True, False])
    mean, variance = mean_and_variance(total, squares, alpha, covered)
    assert mean.tolist() == pytest.approx([7 / 3, 0])
    assert variance.tolist() == pytest.approx([2 / 9, 0])
    variance.sum().backward()
    assert alpha.grad is not None
    assert alpha.grad[1] == 0
    assert gradcheck(lambda t, s, a: mean_and_variance(t, s, a, covered), (total, squares, alpha))


# -- what each Gaussian learns besides -----------------------------------------------------------------------------


def test_what_gaussians_own_multiplies_with_them():
    some = Splats.at_random(torch.ones(3), 5, 0, GaussianRates(), torch.Generator().manual_seed(0))
    config = method()
    drawing = RelightableDrawing(config, config.rasterizer.build(torch.device("cpu")), torch.device("cpu"))
    gaussians = some.gaussians(1)
    values = drawing.own_values(gaussians)
    assert ((values["normals"] * gaussians.means).sum(dim=1) >= 0).all()
    assert torch.allclose(values["normals"].abs(), gaussians.rotations[:, :, 0].abs())
    owning = some.owning({**values, "roughness": torch.arange(5.0)}, drawing.own_rates())
    owning.pull, owning.shown = torch.tensor([0.0, 2, 0, 0, 0]), torch.ones(5)
    after = owning.renewed(DensityConfig(gradient=1.0, large=100.0), torch.Generator())
    assert after.own["roughness"].tolist() == [0, 1, 2, 3, 4, 1]
    again = Splats.of_state(after.state(), GaussianRates(), drawing.own_rates())
    assert torch.equal(again.own["normals"], after.own["normals"])
    assert some.own == {}


@pytest.mark.slow
def test_it_learns_materials_and_light_late_and_masks_where_there_are_any():
    session = sculpt.Session(small_scene(), small(12))
    assert session.reconstructor.state()["shared/0"].shape == (16, 3)
    reports = list(session)
    early = {"color", "normal", "spread", "mask"}
    assert set(reports[4].terms) == early
    assert set(reports[-1].terms) == early | {"shaded", "white"}
    state = session.reconstructor.state()
    assert float(state["albedo"].abs().max()) > 0
    assert float(state["shared/0"][1:].abs().max()) > 0
    scene = small_scene()
    bare = replace(scene, train=tuple(replace(view, alpha=None) for view in scene.train))
    assert all("mask" not in report.terms for report in sculpt.Session(bare, small(1)))


@pytest.mark.slow
def test_it_learns():
    session = sculpt.Session(small_scene(), replace(small(150), holdout_every=4))
    first = beginning_of(session)
    reports = list(session)
    assert session.curve[-1]["psnr"] > first["psnr"] + 3
    shaded = [report.terms["shaded"] for report in reports if "shaded" in report.terms]
    assert np.mean(shaded[-15:]) < 0.9 * np.mean(shaded[:5])
    assert session.mesh().to_trimesh().is_watertight


@pytest.mark.slow
def test_gone_on_with_it_is_what_it_would_have_been():
    config = replace(small(40), materials_from=0.1)
    states: dict[int, dict[str, torch.Tensor]] = {}
    session = sculpt.Session(small_scene(), config)
    method = session.reconstructor
    for report in session:
        states[report.step] = method.state()
    again = sculpt.Session(small_scene(), config).reconstructor
    again.load_state(states[10])
    for step in range(10, 40):
        moment = Moment(step=step, progress=step / 40)
        again.settle(moment)
        again.step(moment)
    for key, value in again.state().items():
        # What was measured last is told, not learned from.
        assert key == "faces" or torch.equal(value, states[40][key]), key
    assert len(states[40]["normals"]) == len(states[40]["means"]) != len(states[10]["means"])
