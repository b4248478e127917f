"""Slot ``losses``: the terms of the outer objective. ``photometric`` is also the inner objective."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.types import Camera, Rendering, Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """What a rendering is compared with: the image over the same background, and its coverage."""

    rgb: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingImage:
    """A view as a stage learns from it: cropped to the object and scaled."""

    name: str
    camera: Camera
    """In the object frame."""
    premultiplied: Float[Tensor, "h w 3"]
    """Colour times alpha; plain colour where there is no mask."""
    alpha: Float[Tensor, "h w"] | None

    def over(self, background: Float[Tensor, " 3"]) -> Target:
        """What a rendering over this background should look like."""
        if self.alpha is None:
            return Target(rgb=self.premultiplied, alpha=None)
        return Target(rgb=self.premultiplied + (1 - self.alpha)[..., None] * background, alpha=self.alpha)


class ImageLoss(ABC):
    """A term of one view's rendering."""

    @abstractmethod
    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]: ...


class GeometryLoss(ABC):
    """A term of the extracted surface and the field around it."""

    @abstractmethod
    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]: ...


class ViewsLoss(ABC):
    """A term of the extracted surface and of what the photographs show of it, without Gaussians between the two."""

    @property
    @abstractmethod
    def views(self) -> int:
        """How many views are looked at in an outer step."""

    @abstractmethod
    def begin(self, images: Sequence[TrainingImage]) -> None:
        """A stage begins, in which these are the images."""

    @abstractmethod
    def __call__(self, surface: Surface, views: Sequence[int], step: int) -> Float[Tensor, ""]:
        """The mean over these views, by their numbers among the stage's images. ``surface`` is in the object frame.

        ``step`` counts outer steps, also over a pause and in several processes: what takes turns goes by it.
        """
