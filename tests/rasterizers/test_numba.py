"""The CPU kernels in float32 against the reference in float64."""

from dataclasses import replace
from itertools import product

import pytest
import torch
from torch import Tensor

from sculpt_framework.errors import DeviceError
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from tests.rasterizers.splats import INPUTS, Splats, facing_splats, random_rotations, random_splats, rendered

CPU = torch.device("cpu")


def _relative(value: Tensor, expected: Tensor) -> float:
    scale = float(expected.norm())
    return float((value.double() - expected).norm()) / (scale if scale > 0 else 1.0)


def _assert_same(splats: Splats, image_tolerance: float = 2e-5, gradient_tolerance: float = 2e-4) -> None:
    expected, expected_gradients = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    output, gradients = rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32)
    for name in ("features", "alpha", "depth"):
        image = getattr(output, name)
        assert torch.isfinite(image).all()
        error = (image.double() - getattr(expected, name)).abs().max()
        assert error < image_tolerance * max(1.0, float(getattr(expected, name).abs().max())), name
    for name in INPUTS:
        assert torch.isfinite(gradients[name]).all(), name
        assert _relative(gradients[name], expected_gradients[name]) < gradient_tolerance, name


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 6, 7, 9, 14, 16])
def test_channels(channels: int):
    _assert_same(random_splats(channels=channels, seed=channels))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 15), (1, 40), (64, 48)])
def test_image_sizes(size: tuple[int, int]):
    _assert_same(random_splats(width=size[0], height=size[1]))


def test_background_per_pixel():
    splats = random_splats()
    image = torch.rand(splats.camera.height, splats.camera.width, 3, dtype=torch.float64)
    _assert_same(replace(splats, background=image))


@pytest.mark.parametrize("alpha_max", [0.5, 0.999])
def test_ceiling_of_alpha(alpha_max: float):
    splats = random_splats(count=60)
    _assert_same(replace(splats, opacities=splats.opacities.clamp(min=0.6), alpha_max=alpha_max))


@pytest.mark.parametrize("opacity", [0.99, 0.999, 1.0 - 1e-7])
def test_nearly_opaque(opacity: float):
    splats = random_splats(count=400, seed=3)
    _assert_same(replace(splats, opacities=torch.full_like(splats.opacities, opacity)), gradient_tolerance=5e-4)


@pytest.mark.parametrize("low_pass", [0.05, 0.3])
@pytest.mark.parametrize("aspect", [1e-2, 1e-4, 1e-6])
def test_slivers(aspect: float, low_pass: float):
    splats = random_splats(count=120, seed=5)
    thin = torch.tensor([aspect, 1.0, aspect], dtype=torch.float64)
    _assert_same(replace(splats, scales=0.15 * thin.repeat(120, 1), low_pass_px2=low_pass), image_tolerance=1e-4)


def test_sliver_across_the_whole_screen():
    """Long, thin and diagonal: the exponent is a difference of numbers in the thousands if one forms it carelessly."""
    angle = torch.tensor(0.7, dtype=torch.float64)
    splats = facing_splats(torch.tensor([[0.01, 0.02, 1.0]]), torch.tensor([[1.0, 1e-5, 1e-5]]), size=200, focal=200.0)
    turn = torch.eye(3, dtype=torch.float64)
    turn[:2, :2] = torch.stack([torch.stack([angle.cos(), -angle.sin()]), torch.stack([angle.sin(), angle.cos()])])
    _assert_same(
        replace(splats, rotations=turn[None], low_pass_px2=0.05), image_tolerance=3e-4, gradient_tolerance=1e-3
    )


def test_off_screen_behind_and_at_the_camera():
    depths = torch.tensor([-1.0, -1e-3, 0.0, 1e-3, 9e-3, 0.011, 0.05, 1.0, 1.0, 1.0, 1e4])
    sideways = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.002, 0.01, 0.7, 3.0, 1e6, 10.0])
    means = torch.stack([sideways, 0.3 * sideways, depths], dim=1)
    scales = torch.full((11, 3), 0.05)
    scales[5:7] = 0.002
    _assert_same(facing_splats(means, scales))


def test_sub_pixel_and_screen_filling():
    means = torch.tensor([[0.01, 0.02, 2.0], [0.1, 0.0, 1.0], [-0.2, 0.1, 3.0]])
    scales = torch.tensor([[1e-6, 1e-6, 1e-6], [5.0, 5.0, 5.0], [80.0, 80.0, 1.0]])
    _assert_same(facing_splats(means, scales))


def test_equal_depths_go_by_index():
    means = torch.tensor([[0.0, 0.0, 1.0]]).repeat(6, 1)
    means[:, 0] = torch.linspace(-0.2, 0.2, 6)
    splats = facing_splats(means, torch.full((6, 3), 0.2))
    _assert_same(splats)
    turned = replace(splats, features=splats.features.flip(0), means=splats.means.flip(0))
    assert not torch.allclose(
        rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32)[0].features,
        rendered(NumbaRasterizerConfig().build(CPU), turned, torch.float32)[0].features,
    )


def test_depths_over_many_octaves():
    """More bits in the sorting keys than two passes take."""
    generator = torch.Generator().manual_seed(2)
    depths = 10.0 ** (torch.rand(200, generator=generator) * 6.0 - 1.9)
    sideways = 0.3 * torch.randn(200, 2, generator=generator) * depths[:, None]
    means = torch.cat([sideways, depths[:, None]], dim=1)
    _assert_same(facing_splats(means, 0.05 * depths[:, None].repeat(1, 3), opacity=0.3))


def test_long_lists():
    """Several batches per tile, most of what they hold hidden."""
    splats = random_splats(count=3000, width=40, height=40, seed=9)
    _assert_same(replace(splats, opacities=0.3 + 0.6 * splats.opacities), gradient_tolerance=1e-3)


@pytest.mark.parametrize("depth", [1.0, -1.0])
def test_nothing_to_draw(depth: float):
    count = 0 if depth > 0 else 4
    splats = facing_splats(torch.tensor([[0.0, 0.0, depth]]).repeat(count, 1), torch.full((count, 3), 0.1))
    output, gradients = rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32)
    assert (output.alpha == 0).all()
    assert (output.depth == 0).all()
    assert all((gradient == 0).all() for gradient in gradients.values())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *product(("means", "scales", "rotations", "opacities", "features"), (float("nan"), float("inf"))),
        *product(("means", "scales", "rotations", "features"), (1e30,)),
    ],
)
def test_what_is_not_finite_is_not_drawn(field: str, value: float):
    splats = random_splats(count=30)
    broken = getattr(splats, field).clone()
    broken[11] = value
    backends = [(NumbaRasterizerConfig(), torch.float32)]
    if value != 1e30:  # float64 can still hold its square
        backends.append((ReferenceRasterizerConfig(), torch.float64))
    for config, dtype in backends:
        rasterizer = config.build(CPU)
        keep = torch.arange(30) != 11
        without = replace(splats, **{name: getattr(splats, name)[keep] for name in INPUTS[:5]})
        expected, expected_gradients = rendered(rasterizer, without, dtype)
        output, gradients = rendered(rasterizer, replace(splats, **{field: broken}), dtype)
        torch.testing.assert_close(output.features, expected.features)
        for name in INPUTS[:5]:
            assert (gradients[name][11] == 0).all(), name
            torch.testing.assert_close(gradients[name][keep], expected_gradients[name])


def test_only_what_is_asked_for_is_differentiated():
    splats = random_splats(count=20)
    rasterizer = NumbaRasterizerConfig().build(CPU)
    means = splats.means.float().requires_grad_(True)
    arguments = [getattr(splats, name).float() for name in INPUTS[1:5]]
    camera = splats.camera.to(CPU, torch.float32)
    gradients = []
    for image in ("features", "alpha", "depth"):
        output = rasterizer.rasterize(
            means, *arguments, camera, splats.background.float(), low_pass_px2=0.3, alpha_max=0.999
        )
        gradients.append(torch.autograd.grad(getattr(output, image).sum(), means)[0])
    output = rasterizer.rasterize(
        means, *arguments, camera, splats.background.float(), low_pass_px2=0.3, alpha_max=0.999
    )
    (total,) = torch.autograd.grad(output.features.sum() + output.alpha.sum() + output.depth.sum(), means)
    torch.testing.assert_close(gradients[0] + gradients[1] + gradients[2], total, rtol=1e-4, atol=1e-4)


def test_renderings_in_flight_do_not_disturb_each_other():
    rasterizer = NumbaRasterizerConfig().build(CPU)
    alone = [rendered(rasterizer, random_splats(seed=seed), torch.float32)[1]["means"] for seed in (0, 1)]
    outputs, leaves = [], []
    for seed in (0, 1):
        splats = random_splats(seed=seed)
        leaf = splats.means.float().requires_grad_(True)
        arguments = [getattr(splats, name).float() for name in INPUTS[1:5]]
        camera = splats.camera.to(CPU, torch.float32)
        outputs.append(
            rasterizer.rasterize(leaf, *arguments, camera, splats.background.float(), low_pass_px2=0.3, alpha_max=0.999)
        )
        leaves.append(leaf)
    generator = torch.Generator()
    for output, leaf, expected in zip(outputs, leaves, alone, strict=True):
        for again in (True, False):
            leaf.grad = None
            generator.manual_seed(7)
            images = (output.features, output.alpha, output.depth)
            weights = [torch.randn(i.shape, dtype=torch.float64, generator=generator).float() for i in images]
            total = sum((image * weight).sum() for image, weight in zip(images, weights, strict=True))
            total.backward(retain_graph=again)
            torch.testing.assert_close(leaf.grad, expected)


@pytest.fixture
def _threads_restored():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def _many_splats() -> Splats:
    return random_splats(count=2000, width=160, height=130, focal=160.0)


@pytest.mark.usefixtures("_threads_restored")
@pytest.mark.parametrize("threads", [1, 2])
def test_repeats_to_the_last_bit(threads: int):
    torch.set_num_threads(threads)
    rasterizer = NumbaRasterizerConfig().build(CPU)
    first, second = (rendered(rasterizer, _many_splats(), torch.float32) for _ in range(2))
    assert torch.equal(first[0].features, second[0].features)
    assert all(torch.equal(first[1][name], second[1][name]) for name in INPUTS)


@pytest.mark.usefixtures("_threads_restored")
def test_deterministic_whatever_the_threads():
    rasterizer = NumbaRasterizerConfig(deterministic=True).build(CPU)
    results = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        results.append(rendered(rasterizer, _many_splats(), torch.float32))
    assert torch.equal(results[0][0].features, results[1][0].features)
    assert all(torch.equal(results[0][1][name], results[1][1][name]) for name in INPUTS)


def test_rotation_of_the_world_changes_nothing():
    splats = random_splats()
    turn = torch.eye(4, dtype=torch.float64)
    turn[:3, :3] = random_rotations(1, torch.Generator().manual_seed(11))[0]
    camera = replace(splats.camera, world_to_camera=splats.camera.world_to_camera @ turn.T)
    turned = replace(
        splats,
        means=splats.means @ turn[:3, :3].T,
        rotations=turn[:3, :3] @ splats.rotations,
        camera=camera,
    )
    rasterizer = NumbaRasterizerConfig().build(CPU)
    torch.testing.assert_close(
        rendered(rasterizer, turned, torch.float32)[0].features,
        rendered(rasterizer, splats, torch.float32)[0].features,
        rtol=0.0,
        atol=1e-4,
    )


def test_other_types_are_refused():
    with pytest.raises(TypeError, match=r"means is torch\.float64"):
        rendered(NumbaRasterizerConfig().build(CPU), random_splats(), torch.float64)


def test_other_devices_are_refused():
    with pytest.raises(DeviceError, match="--rasterizer auto"):
        NumbaRasterizerConfig().build(torch.device("meta"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"alpha_max": 1.0}, "alpha_max"),
        ({"low_pass_px2": -0.1}, "low_pass_px2"),
        ({"features": torch.zeros(150, 0), "background": torch.zeros(0)}, "channels"),
    ],
)
def test_limits(change: dict, message: str):
    with pytest.raises(ValueError, match=message):
        rendered(NumbaRasterizerConfig().build(CPU), replace(random_splats(), **change), torch.float32)
