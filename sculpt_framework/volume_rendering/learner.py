"""A volume that learns from pixels drawn at random, whatever it is learned for."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from sculpt_framework.adam import Adam
from sculpt_framework.parameters import state_below
from sculpt_framework.volume_rendering.config import Passing
from sculpt_framework.volume_rendering.occupancy import Occupancy
from sculpt_framework.volume_rendering.pixels import Pixels
from sculpt_framework.volume_rendering.stretches import stretches_of
from sculpt_framework.volume_rendering.volume import Volume, look_along

LOOK_EVERY = 16
"""Steps between looks at where something may be."""


@dataclass(frozen=True, kw_only=True)
class Lesson:
    """What a step learned from."""

    loss: float
    terms: Mapping[str, float]
    facts: Mapping[str, Any]


class VolumeLearner:
    """Moves the volume's parameters by Adam until rays through pixels bring their colours."""

    def __init__(self, volume: Volume, passing: Passing, half_sides: Float[Tensor, " 3"], generator: torch.Generator):
        """What is random follows the generator. All is where the volume is."""
        self.volume, self._passing, self._generator = volume, passing, generator
        self._optimizer = Adam(list(volume.parameter_groups()), betas=(0.9, 0.99))
        self._device = next(volume.parameters()).device
        self.occupancy = Occupancy(half_sides.float(), passing.cells, self._device)

    def look(self, *, afresh: bool = False) -> None:
        """Ask the volume where something may be."""
        step = self._passing.step
        self.occupancy.look(
            lambda points, radius: self.volume.most_opaque(points, radius, step), self._generator, afresh=afresh
        )

    def learn(self, images: Pixels, rate: float, number: int) -> Lesson:
        """Step ``number``, from 0, with learning rates times ``rate``. Raises FloatingPointError for a loss that is not
        finite."""
        passing, random = self._passing, self._generator
        pixels = images.draw(passing.rays, random)
        jitter = torch.rand(passing.rays, generator=random).to(self._device)
        stretches = stretches_of(pixels.rays, self.occupancy.cells, passing.step, jitter)
        seen = look_along(self.volume, pixels.rays, stretches)
        # Over a colour at random black places in front of nothing are not as good as none.
        background = torch.rand(3, generator=random).to(self._device)
        made = seen.rgb + (1 - seen.alpha)[:, None] * background
        wanted = pixels.premultiplied + (1 - pixels.alpha)[:, None] * background
        terms = {"color": self.volume.color_loss(made, wanted)}
        terms |= self.volume.shape_terms(pixels.rays, stretches, random)
        if passing.mask_weight > 0:
            alpha = seen.alpha.clamp(1e-4, 1 - 1e-4)
            terms["mask"] = passing.mask_weight * functional.binary_cross_entropy(alpha, pixels.alpha)
        loss = torch.stack(list(terms.values())).sum()
        if not torch.isfinite(loss):
            raise FloatingPointError(f"the loss is {float(loss.detach())}")
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step(rate)
        if (number + 1) % LOOK_EVERY == 0:
            self.look()
        told = {name: float(term.detach()) for name, term in terms.items()}
        facts = {"stretches": len(stretches), **self.volume.facts()}
        return Lesson(loss=float(loss.detach()), terms=told, facts=facts)

    def state(self) -> dict[str, Tensor]:
        volume = {f"volume/{name}": value for name, value in self.volume.state_dict().items()}
        optimizer = {f"optimizer/{name}": value for name, value in self._optimizer.state().items()}
        own = {"opacity": self.occupancy.opacity, "random": self._generator.get_state()}
        return {name: value.detach().clone().contiguous() for name, value in (volume | optimizer | own).items()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``, which may hold more. Raises KeyError or RuntimeError for another volume's."""
        self.volume.load_state_dict(state_below(state, "volume/"))
        self._optimizer.load_state(state_below(state, "optimizer/"))
        self.occupancy.opacity = state["opacity"].to(self._device).clone()
        self._generator.set_state(state["random"].clone())
