"""Distance constraint (paper, equations 7 and 8)."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.binders import Binding
from sculpt_framework.constraints import Constraint

_TINY = 1e-12


class Spacing(Constraint):
    """Mean of |distance to the nearest other Gaussian of the face, in barycentric coordinates, - 1 / sqrt(K)|.

    K = 1 has no neighbour: 0. Coincident Gaussians: the square root is rounded off, so the gradient is 0 and not NaN;
    the placement tables keep starts apart.
    """

    def __call__(self, binding: Binding) -> Float[Tensor, ""]:
        weights = binding.barycentrics
        count = weights.shape[1]
        if count == 1:
            return weights.new_zeros(())
        squared = (weights[:, :, None] - weights[:, None]).square().sum(dim=3)
        itself = torch.eye(count, dtype=torch.bool, device=weights.device)
        nearest = squared.masked_fill(itself, 4.0).amin(dim=2)
        return ((nearest + _TINY).sqrt() - count**-0.5).abs().mean()
