"""What else than images tells where an object is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from sculpt_framework.types import Box

_ENOUGH_POINTS = 30
_QUANTILE = 0.02
"""Share of points cut off at each end of each axis: triangulation leaves strays."""
_POINT_MARGIN = 0.15
"""Added at each side, as a share of the longest side: points are where there is texture, not everywhere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Clues:
    """What a layout knows of where the object is, besides its images. World frame."""

    points: Float64[np.ndarray, "n 3"]
    """Of a sparse reconstruction; may be none, and may lie on what is around the object."""
    box: Box | None = None
    """Where the data themselves say the object is."""
    box_name: str = "the box that comes with the cameras"
    """What that is, for people."""


NO_CLUES = Clues(points=np.zeros((0, 3)))


def points_bounds(
    points: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]] | None:
    """Corners of a box around what points are on, without strays; None where too few tell."""
    if len(points) < _ENOUGH_POINTS:
        return None
    low, high = np.quantile(points, [_QUANTILE, 1 - _QUANTILE], axis=0)
    margin = _POINT_MARGIN * (high - low).max()
    return low - margin, high + margin
