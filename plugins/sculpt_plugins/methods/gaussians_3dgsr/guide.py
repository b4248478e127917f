"""Opacities that follow a signed distance (3DGSR: Lyu et al. 2024)."""

import math
from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.free_gaussians.drawing import Terms
from sculpt_framework.free_gaussians.splats import Worth
from sculpt_framework.guided_gaussians.guide import Guide, RayLesson
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.types import Gaussians
from sculpt_framework.volume_rendering.volume import Places
from sculpt_plugins.methods.gaussians_3dgsr.config import Gaussians3dgsrConfig


class OpacityGuide(Guide):
    """The field is taught by the Gaussians' colours, through their opacities; what rays bring of it are depths and
    normals alone."""

    def __init__(self, config: Gaussians3dgsrConfig):
        super().__init__(config)
        self._rate = config.bell_rate
        self._tenth = nn.Parameter(torch.tensor(0.1 * math.log(config.bell)))
        """Of the logarithm of beta, learned as the sharpness of rays is."""

    @property
    def beta(self) -> Float[Tensor, ""]:
        return (10 * self._tenth).exp()

    def guided(self, gaussians: Gaussians) -> Gaussians:
        return replace(gaussians, opacities=bell(self.volume.field(gaussians.means), self.beta))

    @torch.no_grad()
    def worth(self, gaussians: Gaussians) -> Worth:
        opacities = self.guided(gaussians).opacities
        return Worth(opacities=opacities, pull=torch.zeros_like(opacities))

    def seen_terms(self, lesson: RayLesson, places: Places, through: Float[Tensor, " r"]) -> Terms:
        return {}

    def parameter_groups(self) -> list[ParameterGroup]:
        own = ParameterGroup(parameters=[self._tenth], rate=self._rate)
        return [*self.volume.parameter_groups(), own]

    def facts(self) -> Mapping[str, float]:
        return {**self.volume.facts(), "beta": float(self.beta.detach())}


def bell(sdf: Float[Tensor, " n"], beta: Float[Tensor, ""]) -> Float[Tensor, " n"]:
    """4 e^(-beta f) / (1 + e^(-beta f))^2, f the signed distance (paper, Phi_beta), scaled to 1 at 0.

    As the squared secant of beta f / 2, by e^(-|beta f|), which is finite however far away: 0 there, without gradient.
    """
    fallen = torch.exp(-(beta * sdf).abs())
    return 4 * fallen / (1 + fallen).square()
