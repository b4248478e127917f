"""The part of an image that shows the object."""

from jaxtyping import Float
from torch import Tensor


def covered_window(alpha: Float[Tensor, "h w"], margin: int) -> tuple[int, int, int, int]:
    """Column, row, width and height of the part of an image that holds all pixels covered by half, of which there is
    one, and ``margin`` pixels around as far as there are."""
    covered = alpha >= 0.5
    spans = []
    for axis, count in ((0, alpha.shape[1]), (1, alpha.shape[0])):
        places = covered.any(dim=axis).nonzero()[:, 0]
        first = max(0, int(places[0]) - margin)
        spans.append((first, min(count, int(places[-1]) + 1 + margin) - first))
    (x, width), (y, height) = spans
    return x, y, width, height
