"""A bound on how far one step moves the surface, whatever the learning rate.

Adam's step is as long as its rate says, not as far as its gradient can be believed. What a step does to the surface is
known once it is taken, for the price of a look at the field: where it went too far it is shortened, in its direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.geometry.band import levels_of
from sculpt_framework.geometry.signed_distance import SdfFunction

_CELLS_AT_MOST = 256
"""Of a band, evenly chosen; the quantile of the motion at their corners is known to some hundredths."""
_QUANTILE = 0.95
_LOOKS_AT_MOST = 4
"""After one step: a field is not linear in its parameters."""
_SLACK = 1.05
_LEAST_SLOPE = 0.1
"""Smallest length of the distance's gradient that its change is divided by: without one there is no place to move."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BeforeStep:
    """What is kept of the moment before a step."""

    points: Float[Tensor, "n 3"]
    """Corners of the band's cells, object frame."""
    sdf: Float[Tensor, " n"]
    per_cell: Float[Tensor, " n"]
    """Change of the distance that moves the surface by one cell: the gradient's length times the cell's side."""
    parameters: Sequence[Tensor]
    """Copies of the field's."""


class TrustRegion:
    """Bounds the steps of a field's parameters.

    What an extractor learns is left alone: it moves vertices inside their cells, whatever it becomes.
    """

    def __init__(self, cells: float, parameters: Sequence[Tensor]):
        """``cells`` is the bound while learning rates are what they start as; 0: none."""
        self._cells = cells
        self._parameters = parameters

    def look(self, extraction: Extraction, sdf: SdfFunction) -> BeforeStep | None:
        """At the surface before a step; ``sdf`` is the field's distance (object frame). None without a bound."""
        if self._cells == 0:
            return None
        points, values, per_cell = probed(extraction, sdf)
        copies = [parameter.detach().clone() for parameter in self._parameters]
        return BeforeStep(points=points, sdf=values, per_cell=per_cell, parameters=copies)

    @torch.no_grad()
    def shorten(self, before: BeforeStep | None, sdf: SdfFunction, rate: float) -> float:
        """Go back along the step that was taken until the surface has moved no farther than the bound times ``rate``.

        Returns the share of the step that is left. A field that is not finite any more is left for its owner to notice.
        """
        share = 1.0
        if before is None:
            return share
        for _ in range(_LOOKS_AT_MOST):
            moved = motion(before, sdf)
            if not moved > _SLACK * rate * self._cells:
                break
            shorter = rate * self._cells / moved
            share *= shorter
            for parameter, old in zip(self._parameters, before.parameters, strict=True):
                parameter.detach().lerp_(old, 1.0 - shorter)
        return share


@torch.no_grad()
def probed(
    extraction: Extraction, sdf: SdfFunction
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Places, the distance there, and the change of it that moves the surface by one cell."""
    stride = -(-extraction.cells.shape[0] // _CELLS_AT_MOST)
    cells, corners = extraction.cells[::stride], extraction.cell_corners[::stride]
    points = extraction.corner_positions.detach()[corners.reshape(-1)]
    # Not the extraction's own values: at the wall of the grid those are raised.
    values = sdf(points)
    side = extraction.grid.base_cell * torch.pow(0.5, levels_of(cells).to(values))
    cube = values.reshape(-1, 2, 2, 2)
    rises = torch.stack([(cube.select(axis, 1) - cube.select(axis, 0)).mean(dim=(1, 2)) for axis in (1, 2, 3)])
    per_cell = torch.maximum(rises.norm(dim=0), _LEAST_SLOPE * side)
    return points, values, per_cell.repeat_interleave(8)


@torch.no_grad()
def motion(before: BeforeStep, sdf: SdfFunction) -> float:
    """How far the surface has moved since, cells: 95 % of it no farther. NaN if the field is."""
    return float(torch.quantile((sdf(before.points) - before.sdf).abs() / before.per_cell, _QUANTILE))
