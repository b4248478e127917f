"""What the object stands on and before: nothing of it is behind that, whatever silhouettes say."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.types import Box, Support


def before_supports(shape: SdfFunction, supports: Sequence[Support], box: Box) -> SdfFunction:
    """The part of a shape, in the box's frame, that lies before all ``supports``, in world frame.

    max of the shape's value and the distance behind the planes, in object units: exact at the surface, a lower bound of
    the distance outside. Where both are equal, each gets half of the gradient.
    """
    if not supports:
        return shape
    normals = torch.tensor([support.normal for support in supports], dtype=torch.float64)
    offsets = torch.tensor([support.offset for support in supports], dtype=torch.float64)
    offsets = (offsets - normals @ box.center.double()) / box.scale

    def value(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        behind = (offsets.to(points) - points @ normals.to(points).T).amax(dim=1)
        return torch.maximum(shape(points), behind)

    return value
