"""The fields without a hash: the discrete SDF, and the MLP's sizes."""

from dataclasses import replace

import pytest
import torch

from sculpt_framework.errors import ConfigError
from sculpt_plugins.fields.dense_grid.config import DenseGridFieldConfig
from sculpt_plugins.fields.dense_grid.field import DenseGridField
from sculpt_plugins.fields.mlp.config import MlpFieldConfig

CPU = torch.device("cpu")


def some_grid() -> DenseGridField:
    field = DenseGridFieldConfig(resolution=4).build(4, CPU).double()
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        field.values.add_(0.1 * torch.randn(field.values.shape, dtype=torch.float64, generator=generator))
    return field


def test_beyond_the_walls_the_distance_to_them_is_added():
    """Before faces, edges and corners of the box."""
    field = some_grid()
    walls = torch.tensor([[1, 0.3, -0.2], [-1, 1, 0.4], [1, -1, -1]], dtype=torch.float64)
    outward = torch.tensor([[3, 0, 0], [-3, 4, 0], [2, -3, -6]], dtype=torch.float64)
    with torch.no_grad():
        torch.testing.assert_close(
            field(walls + outward) - field(walls), torch.tensor([3.0, 5, 7], dtype=torch.float64)
        )
        assert torch.equal(field(walls + 0 * outward), field(walls))


def test_gradients_of_the_dense_grid_in_and_beyond_its_walls():
    field = some_grid()
    points = torch.tensor([[0.13, -0.4, 0.71], [1.7, 0.3, -0.2], [-1.3, 1.9, 0.4], [2, -3, -6]], dtype=torch.float64)
    assert torch.autograd.gradcheck(field, (points.requires_grad_(),))
    inner = torch.tensor([[0.0, 0, 0], [1, 1, 1], [1, -1, 0.2]], requires_grad=True, dtype=torch.float64)
    (slope,) = torch.autograd.grad(field(inner).sum(), [inner])
    assert torch.isfinite(slope).all()


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
