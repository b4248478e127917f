"""FlexiCubes' L_dev."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.losses import GeometryLoss


class Deviation(GeometryLoss):
    """Mean over dual vertices, in cells: regular where images do not say otherwise. 0 without dual vertices."""

    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]:
        if extraction.deviation.numel() == 0:
            return extraction.corner_sdf.new_zeros(())
        return extraction.deviation.mean() / extraction.grid.cell
