"""Slot ``field``: a signed distance function with parameters."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.parameters import ParameterGroup


class Field(nn.Module, ABC):
    """A differentiable signed distance function on the object frame (paper, 3.1 "Implicit Field Representation").

    Contract (checked for every registered field by ``sculpt_framework.testing``): finite for any finite point, also
    far outside [-1, 1]^3; differentiable by its parameters and by the points; as built, roughly the distance to a
    sphere round the origin (negative inside), so that an extraction finds a closed surface.
    """

    @abstractmethod
    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Signed distance at points of the object frame, in object units; negative inside."""

    @abstractmethod
    def parameter_groups(self) -> Sequence[ParameterGroup]:
        """All parameters, each in one group."""

    def fit_groups(self) -> Sequence[ParameterGroup]:
        """The same with the learning rates of fitting the field to the initial surface, which is far away and known
        exactly. Those of training where a field does not say otherwise."""
        return self.parameter_groups()

    @abstractmethod
    def set_detail(self, cell_size: float) -> None:
        """Tell the field the size of the grid cells it is sampled with (object units): finer levels may wake up."""
