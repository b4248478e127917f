"""Slot ``appearance``: the colours of the Gaussians."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from jaxtyping import Float
from torch import Tensor, nn


class Appearance(nn.Module, ABC):
    """Gives every Gaussian its spherical-harmonics coefficients.

    Rows per face live in the trainer's KeyedTable as the binder's do; what is shared by all faces is the module's own
    parameters. Positions come detached: colour must not open a second route for gradients into geometry.
    """

    @property
    @abstractmethod
    def sh_degree(self) -> int: ...

    @property
    @abstractmethod
    def learning_rates(self) -> dict[str, float]:
        """Names of the row parameters with the rates of the inner loop."""

    @abstractmethod
    def new_rows(self, means: Float[Tensor, "f k 3"]) -> dict[str, Tensor]:
        """Rows "f ..." that a face with Gaussians at these places starts with, if no old face can lend its own."""

    @property
    @abstractmethod
    def inherits_rows(self) -> bool:
        """Whether a new face takes over the rows of the nearest old face instead of ``new_rows``."""

    @abstractmethod
    def forward(self, means: Float[Tensor, "f k 3"], rows: Mapping[str, Tensor]) -> Float[Tensor, "f k b 3"]:
        """Coefficients as in ``Gaussians.sh``."""

    @abstractmethod
    def optimizer_groups(self) -> list[dict]:
        """Parameter groups for Adam, each with ``params`` and its own ``lr``; empty if nothing is shared."""


def check_degree(degree: int) -> None:
    if not 0 <= degree <= 3:
        raise ValueError(f"spherical-harmonics degree must be 0 to 3, not {degree}")


def bands(degree: int) -> int:
    return (degree + 1) ** 2
