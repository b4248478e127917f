"""Colour as the paper has it: coefficients on every Gaussian."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.appearances import Appearance
from sculpt_framework.parameters import ParameterGroup
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig


class PerGaussianAppearance(Appearance):
    """Rows are the coefficients themselves. A new face inherits those of the nearest old one; the first are grey."""

    def __init__(self, config: PerGaussianConfig):
        super().__init__(config.sh_degree)
        self._config = config

    @property
    def rates(self) -> dict[str, float]:
        return {"sh_dc": self._config.rate, **self.band_rates(self._config.rest_rate)}

    @property
    def inherits_rows(self) -> bool:
        return True

    def new_rows(self, means: Float[Tensor, "f k 3"]) -> dict[str, Tensor]:
        return {"sh_dc": torch.zeros_like(means), **self.new_bands(means)}

    def forward(self, means: Float[Tensor, "f k 3"], rows: Mapping[str, Tensor]) -> Float[Tensor, "f k b 3"]:
        return self.with_bands(rows["sh_dc"], rows)

    def parameter_groups(self) -> list[ParameterGroup]:
        return []
