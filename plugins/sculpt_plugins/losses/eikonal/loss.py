"""Gradient norm one (Gropp et al. 2020), from the very samples the extraction used."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.geometry.band import levels_of
from sculpt_framework.losses import GeometryLoss


class Eikonal(GeometryLoss):
    """Mean over the band's cells of (|grad sdf| - 1)^2.

    The gradient of a cell is the mean of the differences along its four parallel edges, which costs no evaluation of
    the field and no second derivative of it. At a vanishing gradient the norm's own gradient is 0.
    """

    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]:
        # Not by indexing: the order in which its backward adds on a CPU changes from run to run.
        corners = extraction.corner_sdf.index_select(0, extraction.cell_corners.reshape(-1)).reshape(-1, 8)
        x = corners[:, 1::2].sum(dim=1) - corners[:, 0::2].sum(dim=1)
        y = corners[:, [2, 3, 6, 7]].sum(dim=1) - corners[:, [0, 1, 4, 5]].sum(dim=1)
        z = corners[:, 4:].sum(dim=1) - corners[:, :4].sum(dim=1)
        # Cells of one extraction may differ in size.
        sides = extraction.grid.base_cell * torch.pow(0.5, levels_of(extraction.cells).to(corners))
        squared = (x * x + y * y + z * z) / (4 * sides) ** 2
        norm = (squared + 1e-12).sqrt()
        return (norm - 1).square().mean()
