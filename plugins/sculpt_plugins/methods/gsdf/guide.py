"""Gaussians and a field that guide each other (GSDF: Yu et al. 2024)."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.free_gaussians.drawing import Terms
from sculpt_framework.free_gaussians.splats import Worth
from sculpt_framework.guided_gaussians.guide import Guide, RayLesson
from sculpt_framework.types import Gaussians
from sculpt_framework.volume_rendering.stretches import Stretches, side_by_side, stretches_around, stretches_of
from sculpt_framework.volume_rendering.volume import Places, seen_from
from sculpt_plugins.methods.gsdf.config import GsdfConfig

_LEAST_STEPS = 2.0
"""Of an even march: the least reach. With none the field's zero could not move to where it is not yet."""


class MutualGuide(Guide):
    """The field learns colours along rays as NeuS does, around the depths that the Gaussians show."""

    def __init__(self, config: GsdfConfig):
        super().__init__(config)
        self._guidance = config.guidance

    @torch.no_grad()
    def worth(self, gaussians: Gaussians) -> Worth:
        """The mean pull gains omega_g mu, the opacity loses omega_p (1 - mu) (paper, 3.2.2)."""
        near = nearness(self.volume.field(gaussians.means), self._guidance.sigma)
        lowered = gaussians.opacities - self._guidance.pruning * (1 - near)
        return Worth(opacities=lowered, pull=self._guidance.growing * near)

    @torch.no_grad()
    def stretches(self, lesson: RayLesson) -> Stretches:
        """D - k |s| to D + k |s|, s the field's value at depth D (paper, 3.2.1); where the Gaussians cover nothing, an
        even march."""
        shown, rays = lesson.shown, lesson.shown.rays
        jitter = torch.rand(len(rays), generator=lesson.generator).to(rays.origins)
        depth = shown.mean_depth
        distance = self.volume.field(rays.origins + depth[:, None] * rays.directions).abs()
        reach = (self._guidance.reach * distance).clamp(min=_LEAST_STEPS * self._step)
        reach = torch.where(shown.covered, reach, 0.0)
        around = stretches_around(rays, depth, reach, self._guidance.samples, jitter - 0.5)
        return side_by_side(around, stretches_of(rays, lesson.cells, self._step, jitter).but_of(reach > 0))

    def seen_terms(self, lesson: RayLesson, places: Places, through: Float[Tensor, " r"]) -> Terms:
        seen = seen_from(self.volume, places, through)
        made = seen.rgb + through[:, None] * lesson.background
        wanted = lesson.premultiplied + (1 - lesson.alpha)[:, None] * lesson.background
        return {"ray color": self.volume.color_loss(made, wanted)}


def nearness(sdf: Float[Tensor, " n"], sigma: float) -> Float[Tensor, " n"]:
    """exp(-s^2 / (2 sigma^2)) (paper, 3.2.2, mu): 1 at the field's zero, 0 far from it."""
    return torch.exp(-0.5 * (sdf / sigma).square())
