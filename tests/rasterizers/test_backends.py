"""Every backend in float32 against the reference in float64: one contract, images and all gradients."""

from dataclasses import replace
from itertools import product

import pytest
import torch
from torch import Tensor

from sculpt_framework import testing
from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from tests.rasterizers.backends import CPU, Backend
from tests.rasterizers.splats import INPUTS, Splats, facing_splats, random_rotations, random_splats, rendered, weighted


def _relative(value: Tensor, expected: Tensor) -> float:
    scale = float(expected.norm())
    return float((value.double() - expected).norm()) / (scale if scale > 0 else 1.0)


def _rendered(backend: Backend, splats: Splats) -> tuple[RasterOutput, dict[str, Tensor]]:
    return rendered(backend.rasterizer, splats, torch.float32, backend.device)


def _rasterize(
    rasterizer: Rasterizer, splats: Splats, device: torch.device, means: Tensor | None = None
) -> RasterOutput:
    arguments = [getattr(splats, name).to(device, torch.float32) for name in INPUTS[:5]]
    if means is not None:
        arguments[0] = means
    return rasterizer.rasterize(
        *arguments,
        splats.camera.to(device, torch.float32),
        splats.background.to(device, torch.float32),
        low_pass_px2=splats.low_pass_px2,
        alpha_max=splats.alpha_max,
    )


def _assert_same(
    backend: Backend, splats: Splats, image_tolerance: float = 2e-5, gradient_tolerance: float = 2e-4
) -> None:
    if not backend.exact:
        image_tolerance, gradient_tolerance = max(image_tolerance, 1e-3), max(gradient_tolerance, 2e-2)
    expected, expected_gradients = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    output, gradients = _rendered(backend, splats)
    for name in ("features", "alpha", "depth"):
        image = getattr(output, name)
        assert torch.isfinite(image).all()
        error = (image.double() - getattr(expected, name)).abs().max()
        assert error < image_tolerance * max(1.0, float(getattr(expected, name).abs().max())), name
    for name in INPUTS:
        assert torch.isfinite(gradients[name]).all(), name
        assert _relative(gradients[name], expected_gradients[name]) < gradient_tolerance, name


def _only_exact(backend: Backend, why: str) -> None:
    if not backend.exact:
        pytest.skip(why)


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 6, 7, 9, 14, 16])
def test_channels(backend: Backend, channels: int):
    _assert_same(backend, backend.cloud(channels=channels, seed=channels))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 15), (1, 40), (64, 48)])
def test_image_sizes(backend: Backend, size: tuple[int, int]):
    _assert_same(backend, backend.cloud(width=size[0], height=size[1], tiles=4))


def test_background_per_pixel(backend: Backend):
    splats = backend.cloud()
    image = torch.rand(splats.camera.height, splats.camera.width, 3, dtype=torch.float64)
    _assert_same(backend, replace(splats, background=image))


@pytest.mark.parametrize("alpha_max", [0.5, 0.999])
def test_ceiling_of_alpha(backend: Backend, alpha_max: float):
    if alpha_max != 0.999:
        _only_exact(backend, "has one ceiling only")
    splats = backend.cloud(count=60)
    _assert_same(backend, replace(splats, opacities=splats.opacities.clamp(min=0.6), alpha_max=alpha_max))


@pytest.mark.parametrize("opacity", [0.99, 0.999, 1.0 - 1e-7])
def test_nearly_opaque(backend: Backend, opacity: float):
    splats = backend.cloud(count=400, seed=3)
    opaque = torch.full_like(splats.opacities, opacity)
    _assert_same(backend, replace(splats, opacities=opaque), gradient_tolerance=5e-4)


@pytest.mark.parametrize("low_pass", [0.05, 0.3])
@pytest.mark.parametrize("aspect", [1e-2, 1e-4, 1e-6])
def test_slivers(backend: Backend, aspect: float, low_pass: float):
    splats = backend.cloud(count=120, seed=5)
    thin = torch.tensor([aspect, 1.0, aspect], dtype=torch.float64)
    scales = 0.15 * thin.repeat(splats.means.shape[0], 1)
    _assert_same(backend, replace(splats, scales=scales, low_pass_px2=low_pass), image_tolerance=1e-4)


def test_sliver_across_the_whole_screen(backend: Backend):
    """Long, thin and diagonal: the exponent is a difference of numbers in the thousands if one forms it carelessly."""
    _only_exact(backend, "forms determinants as differences")
    size = 40 if backend.interpreted else 200
    angle = torch.tensor(0.7, dtype=torch.float64)
    splats = facing_splats(
        torch.tensor([[0.01, 0.02, 1.0]]), torch.tensor([[1.0, 1e-5, 1e-5]]), size=size, focal=float(size)
    )
    turn = torch.eye(3, dtype=torch.float64)
    turn[:2, :2] = torch.stack([torch.stack([angle.cos(), -angle.sin()]), torch.stack([angle.sin(), angle.cos()])])
    turned = replace(splats, rotations=turn[None], low_pass_px2=0.05)
    # Along the splat thousands of float32 terms cancel; how well depends on how many threads share the sum.
    _assert_same(backend, turned, image_tolerance=3e-4, gradient_tolerance=2e-3)


def test_off_screen_behind_and_at_the_camera(backend: Backend):
    depths = torch.tensor([-1.0, -1e-3, 0.0, 1e-3, 9e-3, 0.011, 0.05, 1.0, 1.0, 1.0, 1e4])
    sideways = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.002, 0.01, 0.7, 3.0, 1e6, 10.0])
    means = torch.stack([sideways, 0.3 * sideways, depths], dim=1)
    scales = torch.full((11, 3), 0.05)
    scales[5:7] = 0.002
    _assert_same(backend, facing_splats(means, scales, size=16 if backend.interpreted else 32))


def test_sub_pixel_and_screen_filling(backend: Backend):
    means = torch.tensor([[0.01, 0.02, 2.0], [0.1, 0.0, 1.0], [-0.2, 0.1, 3.0]])
    scales = torch.tensor([[1e-6, 1e-6, 1e-6], [5.0, 5.0, 5.0], [80.0, 80.0, 1.0]])
    _assert_same(backend, facing_splats(means, scales, size=16 if backend.interpreted else 32))


def test_equal_depths_go_by_index(backend: Backend):
    _only_exact(backend, "does not break ties")
    means = torch.tensor([[0.0, 0.0, 1.0]]).repeat(6, 1)
    means[:, 0] = torch.linspace(-0.2, 0.2, 6)
    splats = facing_splats(means, torch.full((6, 3), 0.2), size=16 if backend.interpreted else 32)
    _assert_same(backend, splats)
    turned = replace(splats, features=splats.features.flip(0), means=splats.means.flip(0))
    straight = _rasterize(backend.rasterizer, splats, backend.device).features
    assert not torch.allclose(straight, _rasterize(backend.rasterizer, turned, backend.device).features)


def test_depths_over_many_octaves(backend: Backend):
    """More bits in the sorting keys than two passes take."""
    count, size = (40, 16) if backend.interpreted else (200, 32)
    generator = torch.Generator().manual_seed(2)
    depths = 10.0 ** (torch.rand(count, generator=generator) * 6.0 - 1.9)
    sideways = 0.3 * torch.randn(count, 2, generator=generator) * depths[:, None]
    means = torch.cat([sideways, depths[:, None]], dim=1)
    _assert_same(backend, facing_splats(means, 0.05 * depths[:, None].repeat(1, 3), opacity=0.3, size=size))


def test_long_lists(backend: Backend):
    """Several batches per tile, most of what they hold hidden."""
    splats = backend.cloud(count=3000, width=40, height=40, seed=9)
    opaque = replace(splats, opacities=0.3 + 0.6 * splats.opacities)
    _assert_same(backend, opaque, gradient_tolerance=1e-3)


@pytest.mark.parametrize("depth", [1.0, -1.0])
def test_nothing_to_draw(backend: Backend, depth: float):
    count = 0 if depth > 0 else 4
    splats = facing_splats(torch.tensor([[0.0, 0.0, depth]]).repeat(count, 1), torch.full((count, 3), 0.1), size=9)
    splats = replace(splats, background=torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64))
    output, gradients = _rendered(backend, splats)
    assert (output.alpha == 0).all()
    assert (output.depth == 0).all()
    torch.testing.assert_close(output.features, splats.background.float().expand(9, 9, 3))
    assert all((gradient == 0).all() for gradient in gradients.values())


BROKEN = [
    *product(("means", "scales", "rotations", "opacities", "features"), (float("nan"), float("inf"))),
    *product(("means", "scales", "rotations", "features"), (1e30,)),
]


def test_what_is_not_finite_is_not_drawn(backend: Backend):
    _only_exact(backend, "draws what is merely large")
    _assert_left_out(backend.rasterizer, backend.cloud(count=200, channels=9), BROKEN, torch.float32, backend.device)


def test_what_is_not_finite_is_not_drawn_by_the_reference():
    infinite = [(field, value) for field, value in BROKEN if value != 1e30]  # float64 can still hold its square
    splats = random_splats(count=40)
    _assert_left_out(ReferenceRasterizerConfig().build(CPU), splats, infinite, torch.float64, CPU)


def _assert_left_out(
    rasterizer: Rasterizer,
    splats: Splats,
    broken: list[tuple[str, float]],
    dtype: torch.dtype,
    device: torch.device,
) -> None:
    """Every second Gaussian has a number of one input spoilt: picture and gradients are as without these Gaussians."""
    spoilt = {name: getattr(splats, name).contiguous().clone() for name in INPUTS[:5]}
    keep = torch.ones(splats.means.shape[0], dtype=torch.bool)
    for index, (field, value) in enumerate(broken):
        # The last number of the input: a feature may belong to a later pass than the others.
        spoilt[field][1 + 2 * index].reshape(-1)[-1] = value
        keep[1 + 2 * index] = False
    assert int((~keep).sum()) == len(broken)
    without = replace(splats, **{name: getattr(splats, name)[keep] for name in INPUTS[:5]})
    expected, expected_gradients = rendered(rasterizer, without, dtype, device)
    output, gradients = rendered(rasterizer, replace(splats, **spoilt), dtype, device)
    torch.testing.assert_close(output.features, expected.features)
    for name in INPUTS[:5]:
        assert (gradients[name][~keep] == 0).all(), name
        torch.testing.assert_close(gradients[name][keep], expected_gradients[name])


def test_only_what_is_asked_for_is_differentiated(backend: Backend):
    splats = backend.cloud(count=20 if not backend.interpreted else 100)
    means = splats.means.to(backend.device, torch.float32).requires_grad_(True)
    gradients = []
    output = _rasterize(backend.rasterizer, splats, backend.device, means)
    for image in ("features", "alpha", "depth"):
        gradients.append(torch.autograd.grad(getattr(output, image).sum(), means, retain_graph=True)[0])
    (total,) = torch.autograd.grad(output.features.sum() + output.alpha.sum() + output.depth.sum(), means)
    torch.testing.assert_close(gradients[0] + gradients[1] + gradients[2], total, rtol=1e-4, atol=1e-4)


def test_renderings_in_flight_do_not_disturb_each_other(backend: Backend):
    clouds = [backend.cloud(seed=seed) for seed in (0, 1)]
    alone = [_rendered(backend, splats)[1]["means"] for splats in clouds]
    leaves = [splats.means.to(backend.device, torch.float32).requires_grad_(True) for splats in clouds]
    outputs = [
        _rasterize(backend.rasterizer, splats, backend.device, leaf)
        for splats, leaf in zip(clouds, leaves, strict=True)
    ]
    for output, leaf, expected in zip(outputs, leaves, alone, strict=True):
        for again in (True, False):
            leaf.grad = None
            weighted(output).backward(retain_graph=again)
            torch.testing.assert_close(leaf.grad.cpu(), expected)


def test_repeats_to_the_last_bit(backend: Backend):
    _only_exact(backend, "adds up atomically")
    first, second = (_rendered(backend, backend.cloud(count=400)) for _ in range(2))
    assert torch.equal(first[0].features, second[0].features)
    assert all(torch.equal(first[1][name], second[1][name]) for name in INPUTS)


def test_rotation_of_the_world_changes_nothing(backend: Backend):
    splats = backend.cloud()
    turn = torch.eye(4, dtype=torch.float64)
    turn[:3, :3] = random_rotations(1, torch.Generator().manual_seed(11))[0]
    camera = replace(splats.camera, world_to_camera=splats.camera.world_to_camera @ turn.T)
    turned = replace(
        splats, means=splats.means @ turn[:3, :3].T, rotations=turn[:3, :3] @ splats.rotations, camera=camera
    )
    images = [_rasterize(backend.rasterizer, each, backend.device).features for each in (turned, splats)]
    torch.testing.assert_close(images[0], images[1], rtol=0.0, atol=1e-4)


def test_other_types_are_refused(backend: Backend):
    with pytest.raises(TypeError, match=r"means is torch\.float64"):
        rendered(backend.rasterizer, backend.cloud(), torch.float64, backend.device)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"alpha_max": 1.0}, "alpha_max"),
        ({"low_pass_px2": -0.1}, "low_pass_px2"),
        ({"features": torch.zeros(100, 0), "background": torch.zeros(0)}, "channels"),
    ],
)
def test_limits(backend: Backend, change: dict, message: str):
    splats = backend.cloud(count=500 if backend.interpreted else 100)
    with pytest.raises(ValueError, match=message):
        _rendered(backend, replace(splats, **change))


def test_contract_on_cases_with_known_answers(backend: Backend):
    testing.check_rasterizer(backend.config, backend.device)
