"""Start from what all silhouettes allow."""

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.types import View


class VisualHull(Initializer):
    def __init__(self, max_views: int):
        self._max_views = max_views

    @property
    def silhouette_first(self) -> bool:
        return False

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        yield visual_hull(views, self._max_views, device)
