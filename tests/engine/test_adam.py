"""Adam on whole tensors against torch's."""

import subprocess
import sys

import pytest
import torch
from torch import nn

from sculpt_framework.adam import Adam
from sculpt_framework.parameters import ParameterGroup


def at_rate(parameters: list[nn.Parameter], rate: float) -> ParameterGroup:
    return ParameterGroup(parameters=parameters, rate=rate)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_it_is_torchs(dtype: torch.dtype):
    generator = torch.Generator().manual_seed(1)
    ours = [nn.Parameter(torch.randn(size, generator=generator, dtype=dtype)) for size in ((7, 3), (5,), (2,))]
    theirs = [nn.Parameter(each.detach().clone()) for each in ours]
    adam = Adam([at_rate(ours[:1], 0.1), at_rate(ours[1:], 0.02)], betas=(0.9, 0.99))
    groups = [{"params": theirs[:1], "lr": 0.1}, {"params": theirs[1:], "lr": 0.02}]
    reference = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15)
    for step in range(20):
        for mine, other in zip(ours[:2], theirs[:2], strict=True):
            mine.grad = torch.randn(mine.shape, generator=generator, dtype=dtype) * 10.0 ** -(step % 3)
            other.grad = mine.grad.clone()
        for group, rate in zip(reference.param_groups, (0.1, 0.02), strict=True):
            group["lr"] = rate * 0.9**step
        adam.step(0.9**step)
        reference.step()
        adam = _carried_over(adam, ours)
    assert adam.taken == 20
    for mine, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-5, atol=1e-6)
    adam.zero_grad()
    assert all(each.grad is None for each in ours)


def _carried_over(adam: Adam, parameters: list[nn.Parameter]) -> Adam:
    """One that starts from the other's saved state. What never had a gradient has none, and has not moved."""
    state = {name: value.clone() for name, value in adam.state().items()}
    assert {name.partition(".")[0] for name in state} == {"0", "1"}
    again = Adam([at_rate(parameters[:1], 0.1), at_rate(parameters[1:], 0.02)], betas=(0.9, 0.99))
    again.load_state(state)
    return again


def test_a_graph_of_values_before_a_step_is_refused():
    parameter = nn.Parameter(torch.ones(3))
    loss = parameter.square().sum()
    parameter.grad = torch.ones(3)
    Adam([at_rate([parameter], 0.1)]).step()
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_a_gradient_that_is_not_a_number_shows():
    parameter = nn.Parameter(torch.ones(3))
    parameter.grad = torch.tensor([1.0, torch.nan, 1.0])
    Adam([at_rate([parameter], 0.1)]).step()
    assert parameter.isnan().tolist() == [False, True, False]


@pytest.mark.slow
def test_a_run_does_not_load_torchs_compiler():
    """It takes seconds, and nothing is compiled by it."""
    script = (
        "import sys\n"
        "from dataclasses import replace\n"
        "from sculpt_framework import registry\n"
        "from sculpt_framework.engine.session import Session\n"
        "from sculpt_framework.stress.small import small_scene\n"
        "config = registry.load_method('gaussian-sculpting-tiny')()\n"
        "trainer = replace(config.trainer, polish_steps=1, fit_steps=2)\n"
        "config = replace(config, steps=1, trainer=trainer, observers=(), data='none')\n"
        "Session(small_scene(pixels=32), config).run()\n"
        "sys.exit('torch._dynamo' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, encoding="utf-8")
    assert done.returncode == 0, done.stderr
