"""Slot ``losses``: the terms of the outer objective. ``photometric`` is also the inner objective."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.types import Rendering


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """What a rendering is compared with: the image over the same background, and its coverage."""

    rgb: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"] | None


class ImageLoss(ABC):
    """A term of one view's rendering."""

    @abstractmethod
    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]: ...


class GeometryLoss(ABC):
    """A term of the extracted surface and the field around it."""

    @abstractmethod
    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]: ...
