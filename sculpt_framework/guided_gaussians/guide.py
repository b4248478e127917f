"""A field beside Gaussians: what it says of them, and what they say of it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from sculpt_framework.free_gaussians.drawing import Terms
from sculpt_framework.free_gaussians.splats import Worth
from sculpt_framework.guided_gaussians.config import GuidedGaussiansConfig
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.types import Gaussians
from sculpt_framework.volume_rendering.logistic import LogisticVolume
from sculpt_framework.volume_rendering.sdf_volume import slopes
from sculpt_framework.volume_rendering.stretches import OccupiedCells, Rays, Stretches, stretches_of
from sculpt_framework.volume_rendering.volume import Places, places_along

COVERED = 0.5
"""Opacity of a pixel from which on it has a depth and a normal."""
_APART = 0.1
"""Object units: depths that differ by more are not compared."""
_NOTEWORTHY = 0.02
"""Share of what a ray brings from which on a place is asked for its normal: six values of the field each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """What a drawing of the Gaussians shows at pixels, and the rays through these. Sums of weight times value."""

    rays: Rays
    alpha: Float[Tensor, " r"]
    depth: Float[Tensor, " r"]
    """Along the rays, from their origin."""
    normal: Float[Tensor, "r 3"]

    @property
    def covered(self) -> Bool[Tensor, " r"]:
        return self.alpha.detach() > COVERED

    @property
    def mean_depth(self) -> Float[Tensor, " r"]:
        """0, without gradient, where nothing is."""
        return mean_of(self.depth, self.alpha, self.covered)


@dataclass(frozen=True, kw_only=True, eq=False)
class RayLesson:
    """Pixels of one view for the field to learn from."""

    shown: Shown
    premultiplied: Float[Tensor, "r 3"]
    """Colour times alpha."""
    alpha: Float[Tensor, " r"]
    background: Float[Tensor, " 3"]
    cells: OccupiedCells
    generator: torch.Generator
    """What is random follows it."""


class Guide(nn.Module, ABC):
    """The field as a volume. All in the object frame."""

    def __init__(self, config: GuidedGaussiansConfig):
        super().__init__()
        self._agreement = config.agreement
        self._mask_weight = config.rays.mask_weight
        self._step = 2.0 / config.rays.steps_across
        self._spacing = 2.0 / config.mesh_cells
        self.volume: LogisticVolume = config.build_volume()

    # -- what it says of the Gaussians ---------------------------------------------------------------------------

    def guided(self, gaussians: Gaussians) -> Gaussians:
        """As they are drawn and saved."""
        return gaussians

    @abstractmethod
    def worth(self, gaussians: Gaussians) -> Worth:
        """What decides of their number, of those that are not yet guided. Without gradient."""

    # -- what it learns ------------------------------------------------------------------------------------------

    def stretches(self, lesson: RayLesson) -> Stretches:
        """Where along its rays to look: everywhere, or where the Gaussians say."""
        rays = lesson.shown.rays
        jitter = torch.rand(len(rays), generator=lesson.generator).to(rays.origins)
        return stretches_of(rays, lesson.cells, self._step, jitter)

    def terms(self, lesson: RayLesson) -> Terms:
        """Of the field's own shape, of masks, and of both agreeing; more is a method's."""
        rays, stretches = lesson.shown.rays, self.stretches(lesson)
        places, through = places_along(self.volume, rays, stretches)
        terms = self.seen_terms(lesson, places, through)
        terms |= self.volume.shape_terms(rays, stretches, lesson.generator)
        if self._mask_weight > 0:
            alpha = (1 - through).clamp(1e-4, 1 - 1e-4)
            terms["mask"] = self._mask_weight * functional.binary_cross_entropy(alpha, lesson.alpha)
        depth, normal = self._apart(lesson.shown, places, through)
        return terms | {"depth": self._agreement.depth * depth, "normal": self._agreement.normal * normal}

    @abstractmethod
    def seen_terms(self, lesson: RayLesson, places: Places, through: Float[Tensor, " r"]) -> Terms:
        """Of what rays bring from these places, and of the light that comes through."""

    def _apart(
        self, shown: Shown, places: Places, through: Float[Tensor, " r"]
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """Mean difference of depths, and 1 - cosine of normals, over the rays that both cover. Depths that lie farther
        apart are of two surfaces, or a mean over both, and teach nothing (GSDF's program)."""
        alpha = 1 - through
        both = shown.covered & (alpha.detach() > COVERED)
        depth = mean_of(places.bring(places.distance[:, None])[:, 0], alpha, both)
        noteworthy = places.those(places.weight.detach() > _NOTEWORTHY)
        normal = noteworthy.bring(slopes(self.volume.field, noteworthy.points, self._spacing))
        apart = torch.where(both, (depth - shown.mean_depth).abs(), 0.0)
        apart = torch.where(apart < _APART, apart, 0.0)
        unlike = torch.where(both, 1 - cosine(normal, shown.normal), 0.0)
        count = both.sum().clamp(min=1)
        return apart.sum() / count, unlike.sum() / count

    def parameter_groups(self) -> Sequence[ParameterGroup]:
        return self.volume.parameter_groups()

    def facts(self) -> Mapping[str, Any]:
        """What is told of a step besides, as JSON values."""
        return self.volume.facts()


def mean_of(total: Float[Tensor, " r"], alpha: Float[Tensor, " r"], covered: Bool[Tensor, " r"]) -> Float[Tensor, " r"]:
    """Sums of weight times value by the sum of weights; 0, without gradient, where not covered."""
    return torch.where(covered, total / torch.where(covered, alpha, 1.0), 0.0)


def cosine(first: Float[Tensor, "n 3"], second: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Of the angle between vectors; 0, without gradient, where one of them has next to no length."""
    squared = first.square().sum(dim=1) * second.square().sum(dim=1)
    known = squared.detach() > 1e-12
    return torch.where(known, (first * second).sum(dim=1) * torch.where(known, squared, 1.0).rsqrt(), 0.0)
