"""The MLP's sizes."""

from dataclasses import replace

import pytest
import torch

from sculpt_framework.errors import ConfigError
from sculpt_plugins.fields.mlp.config import MlpFieldConfig

CPU = torch.device("cpu")


def test_the_layer_before_the_skip_must_have_room_for_the_encoded_point():
    narrow = MlpFieldConfig(hidden_units=39)
    message = (
        r"^--field\.hidden-units is 39; expected more than 39, the inputs with field\.frequencies 6, which "
        r"field\.skip-layer sees again\.$"
    )
    with pytest.raises(ConfigError, match=message):
        narrow.check("field")
    for config in (
        replace(narrow, hidden_units=40),
        replace(narrow, frequencies=5),
        replace(narrow, skip_layer=0),
    ):
        config.check("field")
        assert torch.isfinite(config.build(8, CPU)(torch.zeros(2, 3))).all()
