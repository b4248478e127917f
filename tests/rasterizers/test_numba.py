"""What only the CPU kernels promise; the rest is in test_backends.py."""

import pytest
import torch

from sculpt_framework.errors import DeviceError
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from tests.rasterizers.backends import CPU
from tests.rasterizers.splats import INPUTS, Splats, random_splats, rendered


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


def test_other_devices_are_refused():
    with pytest.raises(DeviceError, match="--rasterizer auto"):
        NumbaRasterizerConfig().build(torch.device("meta"))
