"""VolSDF (Yariv et al. 2021): density that follows a signed distance."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.volume_rendering.sdf_volume import SdfVolume, nearest
from sculpt_framework.volume_rendering.stretches import Rays, Stretches
from sculpt_framework.volume_rendering.volume import DARK
from sculpt_plugins.methods.volsdf.config import VolsdfConfig


class VolsdfVolume(SdfVolume):
    """The paper bounds the error of its sampling; here steps are of one length, and occupied cells alone are passed."""

    def __init__(self, config: VolsdfConfig):
        super().__init__(config.shape)
        self._rate, self._least = config.beta_rate, config.least_beta
        self._log_beta = nn.Parameter(torch.tensor(math.log(config.beta)))

    @property
    def beta(self) -> Float[Tensor, ""]:
        return self._log_beta.exp() + self._least

    def alphas(self, rays: Rays, stretches: Stretches) -> Float[Tensor, " n"]:
        return -torch.expm1(-stretches.length * density(self.field(stretches.points(rays, 0.5)), self.beta))

    def most_opaque(self, points: Float[Tensor, "n 3"], radius: float, step: float) -> Float[Tensor, " n"]:
        sdf, beta = self.field(points), self.beta
        found = -torch.expm1(-step * density(nearest(sdf, radius), beta))
        # Behind so much of full density no light is left.
        return torch.where(torch.exp((sdf + radius) / beta) > DARK, found, 0.0)

    def parameter_groups(self) -> list[ParameterGroup]:
        return [*super().parameter_groups(), ParameterGroup(parameters=[self._log_beta], rate=self._rate)]

    def facts(self) -> Mapping[str, float]:
        return {"beta": float(self.beta.detach())}


def density(sdf: Float[Tensor, " n"], beta: Float[Tensor, ""]) -> Float[Tensor, " n"]:
    """Per object unit: 1 / beta times the cumulative Laplace distribution, of width beta, of minus the distance (paper,
    eq. 2 and 3). At most 1 / beta."""
    half = 0.5 * torch.exp(-sdf.abs() / beta)
    return torch.where(sdf > 0, half, 1 - half) / beta
