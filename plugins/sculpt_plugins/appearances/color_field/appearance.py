"""Colour as a field over position: nothing has to be learned again when the triangulation changes."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.appearances import Appearance
from sculpt_framework.encodings.hash_grid import HashEncoding
from sculpt_framework.parameters import ParameterGroup
from sculpt_plugins.appearances.color_field.config import ColorFieldConfig


class ColorFieldAppearance(Appearance):
    """Band 0 = sum over levels of a grid's interpolated colour, plus the residual row; higher bands are residual only.

    Positions are detached here too, so that colour cannot pull on geometry whatever the caller passes.
    """

    def __init__(self, config: ColorFieldConfig):
        super().__init__(config.sh_degree)
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
    def rates(self) -> dict[str, float]:
        return {"residual_dc": self._config.residual_rate, **self.band_rates(self._config.rest_rate)}

    @property
    def inherits_rows(self) -> bool:
        return False

    def new_rows(self, means: Float[Tensor, "f k 3"]) -> dict[str, Tensor]:
        return {"residual_dc": torch.zeros_like(means), **self.new_bands(means)}

    def forward(self, means: Float[Tensor, "f k 3"], rows: Mapping[str, Tensor]) -> Float[Tensor, "f k b 3"]:
        points = means.detach().reshape(-1, 3)
        encoded = self._encoding(points).reshape(*means.shape[:2], 4)
        return self.with_bands(encoded[..., :3] + rows["residual_dc"], rows)

    def parameter_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=list(self._encoding.parameters()), rate=self._config.rate)]
