"""Parameters that are learned, as fields, appearances and terms hand them to the optimiser."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
