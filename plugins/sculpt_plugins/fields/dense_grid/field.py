"""A discrete SDF: one number per grid corner, trilinear in between."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from sculpt_framework.fields import Field
from sculpt_framework.parameters import ParameterGroup
from sculpt_plugins.fields.dense_grid.config import DenseGridFieldConfig


class DenseGridField(Field):
    """Values on [-1, 1]^3; outside, the value at the nearest wall plus the distance to it."""

    def __init__(self, config: DenseGridFieldConfig):
        super().__init__()
        self._config = config
        axis = torch.linspace(-1.0, 1.0, config.resolution + 1)
        z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
        values = (x * x + y * y + z * z).sqrt() - config.sphere_radius
        self.values = nn.Parameter(values[None, None])

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        inside = points.clamp(-1.0, 1.0)
        sampled = functional.grid_sample(
            self.values, inside[None, None, None], mode="bilinear", padding_mode="border", align_corners=True
        )[0, 0, 0, 0]
        outside = points - inside
        # The root has no gradient at 0, which is where all inner points are; where() passes on what it leaves out as
        # 0 times that gradient, so that the root itself must be of something else.
        squares = outside.square().sum(dim=1)
        beyond = squares > 0
        return sampled + torch.where(beyond, torch.where(beyond, squares, 1.0).sqrt(), 0.0)

    def parameter_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=[self.values], rate=self._config.rate)]

    def fit_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=[self.values], rate=0.03)]

    def set_detail(self, cell_size: float) -> None:
        """The grid's one resolution is always on."""
