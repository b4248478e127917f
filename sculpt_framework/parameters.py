"""Parameters that are learned, as fields, appearances and terms hand them to the optimiser."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import nn


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterGroup:
    """Parameters with one learning rate."""

    parameters: Sequence[nn.Parameter]
    rate: float
    """Learning rate, before the schedule."""
