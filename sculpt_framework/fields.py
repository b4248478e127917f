"""Slot ``field``: a signed distance function with parameters."""

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.types import FieldSample


class Field(nn.Module, ABC):
    """A differentiable signed distance function on the object frame (paper, 3.1 "Implicit Field Representation").

    Contract (checked for every registered field by ``sculpt_framework.testing``): finite for any finite point, also
    far outside [-1, 1]^3; differentiable by its parameters and by the points; as built, roughly the distance to a
    sphere round the origin (negative inside), so that an extraction finds a closed surface.
    """

    @abstractmethod
    def forward(self, points: Float[Tensor, "n 3"]) -> FieldSample:
        """Signed distance and features at points of the object frame."""

    @abstractmethod
    def optimizer_groups(self) -> list[dict]:
        """Parameter groups for Adam, each with ``params`` and its own ``lr`` (before the trainer's schedule)."""

    @abstractmethod
    def set_detail(self, cell_size: float) -> None:
        """Tell the field the size of the grid cells it is sampled with (object units): finer levels may wake up."""
