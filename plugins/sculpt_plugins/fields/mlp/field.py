"""An SDF as an MLP (paper, 3.1 and 4.1)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

from sculpt_framework.encodings.positional import positional_encoding
from sculpt_framework.fields import Field
from sculpt_framework.parameters import ParameterGroup
from sculpt_plugins.fields.mlp.config import MlpFieldConfig


class MlpField(Field):
    """Softplus MLP that starts as the signed distance to a sphere (geometric initialisation, Atzmon and Lipman 2020).

    The encoded waves start with zero weights, so that the start is a sphere whatever the frequencies.
    """

    def __init__(self, config: MlpFieldConfig):
        super().__init__()
        self._config = config
        encoded = 3 + 6 * config.frequencies
        layers: list[nn.Module] = []
        for index in range(config.hidden_layers):
            inputs = encoded if index == 0 else config.hidden_units
            outputs = config.hidden_units
            if config.skip_layer > 0 and index + 1 == config.skip_layer:
                outputs -= encoded  # the skip concatenates the encoded input to this layer's output
            layer = nn.Linear(inputs, outputs)
            _initialise_hidden(layer, first=index == 0, after_skip=0 < config.skip_layer == index, encoded=encoded)
            layers.append(weight_norm(layer))
        self._hidden = nn.ModuleList(layers)
        last = nn.Linear(config.hidden_units, 1)
        _initialise_last(last, config.sphere_radius)
        self._last = weight_norm(last)
        self._activation = nn.Softplus(beta=config.softplus_beta)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        encoded = positional_encoding(points, self._config.frequencies)
        hidden = encoded
        for index, layer in enumerate(self._hidden):
            if 0 < self._config.skip_layer == index:
                hidden = torch.cat([hidden, encoded], dim=1) / math.sqrt(2.0)
            hidden = self._activation(layer(hidden))
        return self._last(hidden)[:, 0]

    def parameter_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=list(self.parameters()), rate=self._config.rate)]

    def fit_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=list(self.parameters()), rate=1e-3)]

    def set_detail(self, cell_size: float) -> None:
        """An MLP has all its frequencies from the start: nothing to wake up."""


@torch.no_grad()
def _initialise_hidden(layer: nn.Linear, *, first: bool, after_skip: bool, encoded: int) -> None:
    layer.bias.zero_()
    layer.weight.normal_(0.0, math.sqrt(2.0) / math.sqrt(layer.out_features))
    if first:
        layer.weight[:, 3:] = 0.0
    elif after_skip:
        # The waves of the re-fed input stay silent at the start; its identity part does not.
        layer.weight[:, layer.in_features - encoded + 3 :] = 0.0


@torch.no_grad()
def _initialise_last(layer: nn.Linear, radius: float) -> None:
    layer.weight.normal_(math.sqrt(math.pi) / math.sqrt(layer.in_features), 1e-4)
    layer.bias.fill_(-radius)
