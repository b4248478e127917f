"""Boundary avoidance (paper, eq. 6)."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binding
from sculpt_framework.constraints import Constraint


class Boundary(Constraint):
    """Mean over faces, Gaussians and coordinates of exp(-steepness alpha)."""

    def __init__(self, steepness: float):
        self._steepness = steepness

    def __call__(self, binding: Binding) -> Float[Tensor, ""]:
        return (-self._steepness * binding.barycentrics).exp().mean()
