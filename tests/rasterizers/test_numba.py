"""What only the CPU kernels promise; the rest is in test_backends.py."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sculpt_framework.errors import DeviceError
from sculpt_plugins.rasterizers.numba import sorting
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from tests.rasterizers.backends import CPU
from tests.rasterizers.splats import INPUTS, Splats, facing_splats, random_splats, rendered, weighted


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
def test_repeats_wherever_in_memory_the_images_lie():
    """Four channels, of which a compiler makes one vector where it can: a few renderings in a hundred differed."""
    torch.set_num_threads(1)
    splats = random_splats(count=300, channels=4, width=48, height=48)
    first, held = rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32), []
    for turn in range(150):
        held.append(torch.empty(1 + 37 * turn % 977))
        again = rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32)
        assert all(torch.equal(first[1][name], again[1][name]) for name in INPUTS)


@pytest.mark.usefixtures("_threads_restored")
def test_deterministic_whatever_the_threads():
    rasterizer = NumbaRasterizerConfig(deterministic=True).build(CPU)
    results = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        results.append(rendered(rasterizer, _many_splats(), torch.float32))
    assert torch.equal(results[0][0].features, results[1][0].features)
    assert all(torch.equal(results[0][1][name], results[1][1][name]) for name in INPUTS)


@pytest.mark.parametrize("channels", [1, 3, 6, 9, 17])
def test_colours_alone_have_the_gradient_they_have_among_others(channels: int):
    """The inner loop learns colours on Gaussians that stay: what their places would learn is left out."""
    rasterizer = NumbaRasterizerConfig().build(CPU)
    splats = random_splats(count=600, channels=channels, width=70, height=60, focal=70.0)
    among_others = rendered(rasterizer, splats, torch.float32)[1]["features"]
    fixed = [getattr(splats, name).float() for name in INPUTS[:4]]
    features = splats.features.float().requires_grad_(True)
    pose = splats.camera.world_to_camera.float()
    output = rasterizer.rasterize(
        *fixed,
        features,
        replace(splats.camera, world_to_camera=pose),
        splats.background.float(),
        low_pass_px2=splats.low_pass_px2,
        alpha_max=splats.alpha_max,
    )
    weighted(output).backward()
    assert bool(features.grad.any())
    assert torch.equal(features.grad, among_others)


@pytest.mark.usefixtures("_threads_restored")
def test_more_pairs_than_32_bits_number_are_refused(monkeypatch: pytest.MonkeyPatch):
    """Positions would wrap around, and lists be written to other places than their own."""
    torch.set_num_threads(1)

    def counted(order: np.ndarray, tiles: np.ndarray, columns: int, counts: np.ndarray) -> None:
        assert counts.shape == (1, 4)
        counts[:] = 2**29

    monkeypatch.setattr(sorting, "count_tiles", counted)
    monkeypatch.setattr(sorting, "fill_tiles", lambda *_: pytest.fail("lists are written"))
    splats = facing_splats(torch.tensor([[0.0, 0.0, 1.0]]), torch.full((1, 3), 0.1))
    with pytest.raises(ValueError, match=r"^2147483648 pairs of a Gaussian and a tile; 32 bits number them"):
        rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32)


def test_other_devices_are_refused():
    with pytest.raises(DeviceError, match="--rasterizer auto"):
        NumbaRasterizerConfig().build(torch.device("meta"))
