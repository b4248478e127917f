"""Slot ``constraints``: what Gaussians on a face must keep to (paper, 3.1). Terms of the inner objective."""

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binding
from sculpt_framework.losses import Term


class Constraint(Term, ABC):
    @abstractmethod
    def __call__(self, binding: Binding) -> Float[Tensor, ""]:
        """The mean penalty over faces and Gaussians; 0 where the constraint holds, finite for any triangle."""
