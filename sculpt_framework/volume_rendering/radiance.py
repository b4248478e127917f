"""Colour by place and direction."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.encodings.hash_grid import HashEncoding
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.rendering.spherical_harmonics import spherical_harmonics
from sculpt_framework.volume_rendering.config import RadianceConfig

_DEGREE = 2
"""Of the spherical harmonics that tell the decoder of the direction: nine numbers."""


def encoding_of(config: RadianceConfig) -> HashEncoding:
    return HashEncoding(
        levels=config.num_levels,
        features_per_level=2,
        log2_table=config.log2_table,
        base_resolution=config.base_resolution,
        finest_resolution=config.finest_resolution,
        init_scale=1e-4,
    )


class ColorDecoder(nn.Module):
    """sRGB in [0, 1] from features of a place and a unit direction of view: two hidden layers."""

    def __init__(self, features: int, hidden_units: int):
        super().__init__()
        self._layers = nn.Sequential(
            nn.Linear(features + (_DEGREE + 1) ** 2, hidden_units),
            nn.ReLU(),
            nn.Linear(hidden_units, hidden_units),
            nn.ReLU(),
            nn.Linear(hidden_units, 3),
        )

    def forward(self, features: Float[Tensor, "n c"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return self._layers(torch.cat([features, spherical_harmonics(directions, _DEGREE)], dim=1)).sigmoid()


class RadianceField(nn.Module):
    """A hash grid of its own and a decoder: for methods whose shape is another field."""

    def __init__(self, config: RadianceConfig):
        super().__init__()
        self._config = config
        self._encoding = encoding_of(config)
        self._decoder = ColorDecoder(2 * config.num_levels, config.hidden_units)

    def forward(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        return self._decoder(self._encoding(points), directions)

    def parameter_groups(self) -> list[ParameterGroup]:
        return [
            ParameterGroup(parameters=list(self._encoding.parameters()), rate=self._config.rate),
            ParameterGroup(parameters=list(self._decoder.parameters()), rate=self._config.decoder_rate),
        ]
