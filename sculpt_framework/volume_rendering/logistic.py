"""Opacity from how far a logistic function of a signed distance falls: an unbiased, occlusion-aware weight (NeuS: Wang
et al. 2021)."""

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.volume_rendering.config import SdfShape
from sculpt_framework.volume_rendering.sdf_volume import SdfVolume, nearest
from sculpt_framework.volume_rendering.stretches import Rays, Stretches
from sculpt_framework.volume_rendering.volume import DARK


class LogisticVolume(SdfVolume):
    def __init__(self, shape: SdfShape, sharpness: float, sharpness_rate: float):
        super().__init__(shape)
        self._rate = sharpness_rate
        self._tenth = nn.Parameter(torch.tensor(0.1 * math.log(sharpness)))
        """Of the logarithm of the sharpness, as NeuS' program learns it."""

    @property
    def sharpness(self) -> Float[Tensor, ""]:
        return (10 * self._tenth).exp()

    def alphas(self, rays: Rays, stretches: Stretches) -> Float[Tensor, " n"]:
        linked = stretches.goes_on
        last = (~linked).nonzero()[:, 0]
        ends = stretches.at(rays, stretches.ray[last], stretches.begin[last] + stretches.length[last])
        sdf = self.field(torch.cat([stretches.points(rays, 0.0), ends]))
        first, beyond = sdf[: len(stretches)], sdf[len(stretches) :]
        # A stretch ends where the next one begins; where there is none, at a place of its own.
        following = torch.cat([first[1:], first[:1]])
        second = torch.where(linked, following, following.new_zeros(len(stretches)).index_put((last,), beyond))
        return opacity(first, second, self.sharpness)

    def most_opaque(self, points: Float[Tensor, "n 3"], radius: float, step: float) -> Float[Tensor, " n"]:
        sdf, sharpness = self.field(points), self.sharpness
        near = nearest(sdf, radius)
        found = opacity(near + 0.5 * step, near - 0.5 * step, sharpness)
        # Light on the way to a place falls as F of the distance does.
        return torch.where(torch.sigmoid(sharpness * (sdf + radius)) > DARK, found, 0.0)

    def parameter_groups(self) -> list[ParameterGroup]:
        return [*super().parameter_groups(), ParameterGroup(parameters=[self._tenth], rate=self._rate)]

    def facts(self) -> Mapping[str, float]:
        return {"sharpness": float(self.sharpness.detach())}


def opacity(
    first: Float[Tensor, " n"], second: Float[Tensor, " n"], sharpness: Float[Tensor, ""]
) -> Float[Tensor, " n"]:
    """(F(first) - F(second)) / F(first), at least 0, F the logistic function (NeuS, eq. 13).

    By the difference of logarithms, which stay finite deep inside, where both F are 0 in floating point. Where the
    distance grows along the stretch the opacity is 0, without gradient.
    """
    falls = functional.logsigmoid(sharpness * second) - functional.logsigmoid(sharpness * first)
    return -torch.expm1(falls.clamp(max=0))
