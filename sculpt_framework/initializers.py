"""Slot ``initializer``: the surface optimisation starts from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.types import View


class Initializer(ABC):
    @property
    def silhouette_first(self) -> bool:
        """Whether the start is so rough that silhouettes alone must shape it before colours can (paper, 3.3)."""
        return False

    @property
    def findings(self) -> Mapping[str, float]:
        """What the views gave to start from, by name, once ``targets`` has run: told with the start."""
        return {}

    @abstractmethod
    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        """Rough signed distances, each better than the one before; the field is fitted to the last.

        Those before are surfaces that were come by on the way, for the curve of error against time: a start is a good
        part of a short run. Views and sides are in the object frame.

        Raises DataError if the views do not allow such a start; the message names an initializer that works.
        """
