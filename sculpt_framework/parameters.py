"""Parameters that are learned, as fields, appearances and terms hand them to the optimiser."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterGroup:
    """Parameters with one learning rate."""

    parameters: Sequence[nn.Parameter]
    rate: float
    """Learning rate, before the schedule."""


def state_below(state: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The part of a saved state whose names begin with ``prefix``, without it."""
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}


def check_slopes(named: Iterable[tuple[str, nn.Parameter]], whose: str) -> None:
    """Raises FloatingPointError for a gradient that is not finite, before it gets into the parameters."""
    for name, parameter in named:
        if parameter.grad is not None and not torch.isfinite(parameter.grad.sum()):
            raise FloatingPointError(f"the slope by the {whose} {name} is not finite")
