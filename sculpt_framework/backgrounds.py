"""Slot ``background``: what photographs show around the object.

It is behind the object in every view: c = c_object + (1 - alpha_object) c_background. So it can hide nothing, and the
surface need not paint the room. It learns in the inner loop, with the Gaussians on the surface.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float64
from numpy import ndarray
from torch import Tensor, nn

from sculpt_framework.types import Box, Gaussians, View


class Background(ABC):
    @property
    @abstractmethod
    def around(self) -> float:
        """How far beyond the object the images of a stage reach, as a share of its longer side in them."""

    @abstractmethod
    def begin(
        self,
        views: Sequence[View],
        box: Box,
        points: Float64[ndarray, "n 3"] | None,
        generator: torch.Generator,
    ) -> None:
        """A run begins with these views and what else is known of places that they show, both in world frame.

        Raises DataError where the views show nothing but the object.
        """

    @abstractmethod
    def gaussians(self) -> Gaussians:
        """In the object frame; gradients reach the parameters."""

    @property
    @abstractmethod
    def parameters(self) -> list[nn.Parameter]:
        """What is learned: none before ``begin`` or ``load_state``."""

    @abstractmethod
    def zero_grad(self) -> None: ...

    @abstractmethod
    def step(self, rate_factor: float) -> None:
        """One optimiser step on whatever has a gradient."""

    @abstractmethod
    def state(self) -> dict[str, Tensor]: ...

    @abstractmethod
    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``. Raises KeyError where an entry is missing."""
