"""Slot ``initializer``: the surface optimisation starts from."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import SdfFunction
from sculpt_framework.types import View


class Initializer(ABC):
    @property
    @abstractmethod
    def silhouette_first(self) -> bool:
        """Whether the start is so rough that silhouettes alone must shape it before colours can (paper, 3.3)."""

    @abstractmethod
    def target(self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device) -> SdfFunction:
        """Roughly a signed distance, for the field to be fitted to. Views and sides are in the object frame.

        Raises DataError if the views do not allow such a start; the message names an initializer that works.
        """
