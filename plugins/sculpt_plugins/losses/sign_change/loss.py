"""The sign-change regulariser of differentiable iso-surfacing."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from sculpt_framework.extractors import Extraction
from sculpt_framework.losses import GeometryLoss


class SignChange(GeometryLoss):
    """Mean over crossed edges of the cross-entropy of each end's distance against the other end's sign.

    Every crossed edge costs something, so surface that nothing else asks for shrinks away.
    """

    def __init__(self, sharpness: float):
        self._sharpness = sharpness

    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]:
        inner, outer = (self._sharpness * extraction.edge_sdf).unbind(dim=1)
        as_outer = functional.binary_cross_entropy_with_logits(inner, torch.ones_like(inner))
        as_inner = functional.binary_cross_entropy_with_logits(outer, torch.zeros_like(outer))
        return as_outer + as_inner
