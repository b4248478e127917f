"""Slot ``appearance``: the colours of the Gaussians."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.parameters import ParameterGroup


class Appearance(nn.Module, ABC):
    """Gives every Gaussian its spherical-harmonics coefficients.

    Rows per face live in the trainer's KeyedTable as the binder's do; what is shared by all faces is the module's own
    parameters. Positions come detached: colour must not open a second route for gradients into geometry.
    """

    def __init__(self, sh_degree: int):
        """``sh_degree`` is 0 to 3."""
        super().__init__()
        self._highest = self._sh_degree = sh_degree

    @property
    def sh_degree(self) -> int:
        return self._sh_degree

    def set_sh_degree(self, degree: int) -> None:
        """Have no bands above this one, in rows neither. Raises ValueError beyond the degree it was made with."""
        if not 0 <= degree <= self._highest:
            raise ValueError(f"spherical harmonics of degree {degree} in an appearance of degree {self._highest}")
        self._sh_degree = degree

    @property
    @abstractmethod
    def rates(self) -> dict[str, float]:
        """Names of the row parameters with their learning rates in the inner loop."""

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
    def parameter_groups(self) -> Sequence[ParameterGroup]:
        """The parameters that all faces share; empty where there are none."""

    # -- bands above the first, each a row parameter of its own: one that is given up leaves nothing behind -----------

    def band_rates(self, rate: float) -> dict[str, float]:
        """Learning rates of the bands from 1 up."""
        return {f"band_{degree}": rate for degree in range(1, self.sh_degree + 1)}

    def new_bands(self, means: Float[Tensor, "f k 3"]) -> dict[str, Tensor]:
        """Rows of the bands from 1 up, "f k 2d+1 3", at 0."""
        return {
            f"band_{degree}": means.new_zeros(*means.shape[:2], 2 * degree + 1, 3)
            for degree in range(1, self.sh_degree + 1)
        }

    def with_bands(self, base: Float[Tensor, "f k 3"], rows: Mapping[str, Tensor]) -> Float[Tensor, "f k b 3"]:
        """Band 0 and what the rows say of those above."""
        above = [rows[f"band_{degree}"] for degree in range(1, self.sh_degree + 1)]
        return torch.cat([base.unsqueeze(2), *above], dim=2) if above else base.unsqueeze(2)


def bands(degree: int) -> int:
    """Coefficients of all bands up to this one."""
    return (degree + 1) ** 2
