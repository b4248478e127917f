"""Adam (Kingma and Ba 2015) on whole tensors, and on rows that have each taken a number of steps of their own.

torch.optim.Adam does the former as well, but when one is first made it loads torch's compiler: two seconds of every
process.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.graph import increment_version

from sculpt_framework.cpu_kernels import float32_on_cpu, kernel_cache, share_threads
from sculpt_framework.parameters import ParameterGroup

with kernel_cache("adam", Path(__file__).with_name("adam_kernels.py")):
    from sculpt_framework import adam_kernels


EPS = 1e-15
"""Keeps the root of a second moment that is still zero from being divided by."""


class Adam:
    """Moves parameters that have a gradient. Their moments come with the first one."""

    def __init__(
        self,
        groups: Sequence[ParameterGroup],
        betas: tuple[float, float] = (0.9, 0.999),
    ):
        self._rates = [(parameter, group.rate) for group in groups for parameter in group.parameters]
        self._betas = betas
        self._moments: dict[int, dict[str, Tensor]] = {}

    @property
    def parameters(self) -> list[nn.Parameter]:
        return [parameter for parameter, _ in self._rates]

    @property
    def taken(self) -> int:
        """Steps that the parameter moved most often has taken."""
        return max((int(state["step"]) for state in self._moments.values()), default=0)

    def zero_grad(self) -> None:
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self, rate_factor: float = 1.0) -> None:
        for index, (parameter, rate) in enumerate(self._rates):
            if parameter.grad is None:
                continue
            if index not in self._moments:
                first, second = torch.zeros_like(parameter), torch.zeros_like(parameter)
                self._moments[index] = {"step": torch.tensor(0.0), "exp_avg": first, "exp_avg_sq": second}
            state = self._moments[index]
            state["step"] += 1
            _move_all(
                parameter.view(-1),
                parameter.grad.reshape(-1),
                state["exp_avg"].view(-1),
                state["exp_avg_sq"].view(-1),
                int(state["step"]),
                rate * rate_factor,
                self._betas,
                EPS,
            )

    def state(self) -> dict[str, Tensor]:
        """Moments and step counts by the position of their parameter, for a checkpoint."""
        return {f"{index}.{name}": value for index, state in self._moments.items() for name, value in state.items()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``, wherever that lies. Raises KeyError for a parameter there is not."""
        self._moments, parameters = {}, dict(enumerate(self.parameters))
        for name, value in state.items():
            index, _, entry = name.partition(".")
            # Steps are counted on the CPU, wherever parameters are.
            device = torch.device("cpu") if entry == "step" else parameters[int(index)].device
            self._moments.setdefault(int(index), {})[entry] = value.to(device).clone()


def move_rows(
    values: Float[Tensor, "n ..."],
    gradients: Float[Tensor, "n ..."],
    first: Float[Tensor, "n ..."],
    second: Float[Tensor, "n ..."],
    steps: Float[Tensor, " n"],
    rate: float,
    betas: tuple[float, float],
    eps: float,
) -> None:
    """Move ``values`` and both moments in place; ``steps`` of each row counts this one."""
    if len(steps) == 0:
        return
    if not float32_on_cpu(values, gradients):
        scale = _bias_correction(steps, betas) * rate
        _move_in_torch(values, gradients, first, second, scale.reshape(-1, *([1] * (values.ndim - 1))), betas, eps)
        return
    share_threads()
    # Steps from 1 upwards; there are far fewer of them than rows.
    taken = torch.arange(1, int(steps.max()) + 1, dtype=torch.float64)
    rates = torch.cat([taken.new_zeros(1), _bias_correction(taken, betas) * rate]).float()
    adam_kernels.move_rows(
        _as_rows(values), _as_rows(gradients.contiguous()), _as_rows(first), _as_rows(second), steps.numpy(),
        rates.numpy(), np.float32(betas[0]), np.float32(betas[1]), np.float32(eps),
    )  # fmt: skip
    increment_version(values)


def _move_all(
    values: Float[Tensor, " n"],
    gradients: Float[Tensor, " n"],
    first: Float[Tensor, " n"],
    second: Float[Tensor, " n"],
    step: int,
    rate: float,
    betas: tuple[float, float],
    eps: float,
) -> None:
    scale = _bias_correction(torch.tensor([step], dtype=torch.float64), betas) * rate
    if not float32_on_cpu(values, gradients):
        _move_in_torch(values, gradients, first, second, scale.to(values), betas, eps)
        return
    share_threads()
    adam_kernels.move_all(
        values.detach().numpy(), gradients.detach().numpy(), first.numpy(), second.numpy(),
        np.float32(float(scale)), np.float32(betas[0]), np.float32(betas[1]), np.float32(eps),
    )  # fmt: skip
    increment_version(values)


def _move_in_torch(
    values: Float[Tensor, "..."],
    gradients: Float[Tensor, "..."],
    first: Float[Tensor, "..."],
    second: Float[Tensor, "..."],
    scale: Float[Tensor, "..."],
    betas: tuple[float, float],
    eps: float,
) -> None:
    """Move ``values`` and both moments in place; ``scale`` is the rate with its bias correction."""
    first.lerp_(gradients, 1 - betas[0])
    second.mul_(betas[1]).addcmul_(gradients, gradients, value=1 - betas[1])
    values.sub_(first / second.sqrt().add_(eps) * scale)


def _as_rows(tensor: Float[Tensor, "n ..."]) -> np.ndarray:
    """The same memory as a matrix."""
    return tensor.detach().view(len(tensor), -1).numpy()


def _bias_correction(steps: Float[Tensor, " n"], betas: tuple[float, float]) -> Float[Tensor, " n"]:
    return (1 - betas[1] ** steps).sqrt() / (1 - betas[0] ** steps)
