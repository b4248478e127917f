"""The start that knows nothing."""

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.types import View


class Sphere(Initializer):
    """(|x / half sides| - fill) * the shortest half side: a sphere in a cubic box, never steeper than a distance."""

    def __init__(self, fill: float):
        self._fill = fill

    @property
    def silhouette_first(self) -> bool:
        return True

    def targets(
        self, views: Sequence[View], half_sides: Float[Tensor, " 3"], device: torch.device
    ) -> Iterator[SdfFunction]:
        sides = half_sides.to(device=device, dtype=torch.float32)
        shortest = float(sides.min())

        def ellipsoid(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            return ((points / sides.to(points)).norm(dim=1) - self._fill) * shortest

        yield ellipsoid
