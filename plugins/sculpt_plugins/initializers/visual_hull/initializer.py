"""Start from what all silhouettes allow."""

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.shape_from_images.closing import close_unseen
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.types import View
from sculpt_plugins.initializers.visual_hull.config import VisualHullConfig


class VisualHull(Initializer):
    """The hull itself, then, where some of its surface faces away from all views, the hull with that side closed."""

    def __init__(self, config: VisualHullConfig):
        self._config = config

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        hull = visual_hull(views, self._config.max_views)
        yield hull
        if self._config.cells == 0:
            return
        x, y, z = (float(side) for side in half_sides)
        solid = sample(hull, (x, y, z), self._config.cells, device)
        closed = close_unseen(solid, [view.camera for view in views if view.alpha is not None])
        if closed is not solid:
            yield closed.within(hull, device)
