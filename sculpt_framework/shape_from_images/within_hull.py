"""What initializers that carve a visual hull share: the hull, closed where no view sees, and what is made of it."""

from collections.abc import Callable, Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.shape_from_images.closing import close_cones, close_unseen
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.volume import Volume, sample
from sculpt_framework.types import View


def within_hull(
    views: Sequence[View],
    half_sides: Float[Tensor, " 3"],
    device: torch.device,
    cells: int,
    max_views: int,
    find: Callable[[Sequence[View], Volume], Volume],
) -> Iterator[SdfFunction]:
    """The visual hull, then the shape that ``find`` makes of masked views, at most so many, and of the hull as a volume
    of so many cells; nothing more where that is the hull. Raises DataError where no view has a mask."""
    hull = visual_hull(views, max_views)
    yield hull
    x, y, z = (float(side) for side in half_sides)
    sampled = sample(hull, (x, y, z), cells, device)
    masked = [view for view in views if view.alpha is not None]
    chosen = masked[:: max(1, -(-len(masked) // max_views))]
    # Before depths are looked for: in a mirror on the ground, what stands on it is seen once more, below.
    cameras = [view.camera for view in chosen]
    shape = close_unseen(find(chosen, close_cones(sampled, cameras)), cameras)
    if shape is sampled:
        return
    yield shape.within(hull, device)
