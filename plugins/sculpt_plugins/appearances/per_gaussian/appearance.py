"""Colour as the paper has it: coefficients on every Gaussian."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.appearances import Appearance, bands, check_degree
from sculpt_plugins.appearances.per_gaussian.config import PerGaussianConfig


class PerGaussianAppearance(Appearance):
    """Rows are the coefficients themselves. A new face inherits those of the nearest old one; the first are grey."""

    def __init__(self, config: PerGaussianConfig):
        super().__init__()
        check_degree(config.sh_degree)
        self._config = config

    @property
    def sh_degree(self) -> int:
        return self._config.sh_degree

    @property
    def learning_rates(self) -> dict[str, float]:
        rates = {"sh_dc": self._config.rate}
        if self.sh_degree > 0:
            rates["sh_rest"] = self._config.rest_rate
        return rates

    @property
    def inherits_rows(self) -> bool:
        return True

    def new_rows(self, means: Float[Tensor, "f k 3"]) -> dict[str, Tensor]:
        rows = {"sh_dc": torch.zeros_like(means)}
        if self.sh_degree > 0:
            rows["sh_rest"] = means.new_zeros(*means.shape[:2], bands(self.sh_degree) - 1, 3)
        return rows

    def forward(self, means: Float[Tensor, "f k 3"], rows: Mapping[str, Tensor]) -> Float[Tensor, "f k b 3"]:
        base = rows["sh_dc"].unsqueeze(2)
        return base if self.sh_degree == 0 else torch.cat([base, rows["sh_rest"]], dim=2)

    def optimizer_groups(self) -> list[dict]:
        return []
