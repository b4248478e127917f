"""Coverage (paper, eq. 9)."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binding
from sculpt_framework.constraints import Constraint


class Coverage(Constraint):
    """Mean over faces and coordinates of max(0, threshold - range of the coordinate over the face's Gaussians).

    K = 1 spans nothing whatever it does: 0, as there is nothing to learn from a constant.
    """

    def __init__(self, threshold: float):
        self._threshold = threshold

    def __call__(self, binding: Binding) -> Float[Tensor, ""]:
        weights = binding.barycentrics
        if weights.shape[1] == 1:
            return weights.new_zeros(())
        spread = weights.amax(dim=1) - weights.amin(dim=1)
        return (self._threshold - spread).clamp(min=0).mean()
