"""FlexiCubes' weight regulariser."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.losses import GeometryLoss


class CubeWeights(GeometryLoss):
    """Mean absolute raw weight; 0 for extractors without weights."""

    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]:
        if extraction.cell_weights is None:
            return extraction.corner_sdf.new_zeros(())
        return extraction.cell_weights.abs().mean()
