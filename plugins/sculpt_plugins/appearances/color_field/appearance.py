"""Colour as a field over position: nothing has to be learned again when the triangulation changes."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.appearances import Appearance, bands, check_degree
from sculpt_framework.encodings.hash_grid import HashEncoding
from sculpt_plugins.appearances.color_field.config import ColorFieldConfig


class ColorFieldAppearance(Appearance):
    """Band 0 = sum over levels of a grid's interpolated colour, plus the residual row; higher bands are residual only.

    Positions are detached here too, so that colour cannot pull on geometry whatever the caller passes.
    """

    def __init__(self, config: ColorFieldConfig):
        super().__init__()
        check_degree(config.sh_degree)
        self._config = config
        self._encoding = HashEncoding(
            levels=config.num_levels,
            features_per_level=4,  # three are used: rows of four floats are what vector loads like
            log2_table=config.log2_table,
            base_resolution=config.base_resolution,
            finest_resolution=config.finest_resolution,
            init_scale=0.0,
            sum_levels=True,
        )

    @property
    def sh_degree(self) -> int:
        return self._config.sh_degree

    @property
    def learning_rates(self) -> dict[str, float]:
        rates = {"residual_dc": self._config.residual_rate}
        if self.sh_degree > 0:
            rates["residual_rest"] = self._config.rest_rate
        return rates

    @property
    def inherits_rows(self) -> bool:
        return False

    def new_rows(self, means: Float[Tensor, "f k 3"]) -> dict[str, Tensor]:
        rows = {"residual_dc": torch.zeros_like(means)}
        if self.sh_degree > 0:
            rows["residual_rest"] = means.new_zeros(*means.shape[:2], bands(self.sh_degree) - 1, 3)
        return rows

    def forward(self, means: Float[Tensor, "f k 3"], rows: Mapping[str, Tensor]) -> Float[Tensor, "f k b 3"]:
        points = means.detach().reshape(-1, 3)
        encoded = self._encoding(points).reshape(*means.shape[:2], 4)
        base = (encoded[..., :3] + rows["residual_dc"]).unsqueeze(2)
        return base if self.sh_degree == 0 else torch.cat([base, rows["residual_rest"]], dim=2)

    def optimizer_groups(self) -> list[dict]:
        return [{"params": list(self._encoding.parameters()), "lr": self._config.rate}]
