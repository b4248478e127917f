"""Slot ``losses``: the terms of the outer objective; one that says so is the inner objective, too.

A term may own parameters (``parameter_groups``), such as an exposure per image: they learn in every step that looks at
them, are kept in checkpoints, and come back when a run is resumed.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import Extraction
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.types import Camera, Rendering, Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """What a rendering is compared with: the image over the same background, its coverage, and which view it is."""

    rgb: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"] | None
    name: str = ""
    """Of the view, as ``TrainingImage.name``."""
    camera: Camera | None = None
    """Of the rendering, in the object frame; None where it is not known."""
    background: Float[Tensor, " 3"] | None = None
    """What both are in front of; None where there is none: the image is all there is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingImage:
    """A view as a stage learns from it: cropped to the object and scaled."""

    name: str
    camera: Camera
    """In the object frame."""
    premultiplied: Float[Tensor, "h w 3"]
    """Colour times alpha; plain colour where there is no mask."""
    alpha: Float[Tensor, "h w"] | None
    photograph: Float[Tensor, "h w 3"] | None = None
    """The colours with what is around the object; None where that is not looked at."""

    def over(self, background: Float[Tensor, " 3"]) -> Target:
        """What a rendering over this background should look like."""
        if self.alpha is None:
            return Target(rgb=self.premultiplied, alpha=None, name=self.name, camera=self.camera)
        rgb = self.premultiplied + (1 - self.alpha)[..., None] * background
        return Target(rgb=rgb, alpha=self.alpha, name=self.name, camera=self.camera, background=background)

    def whole(self) -> Target:
        """What a rendering with all that is around the object should look like."""
        assert self.photograph is not None, "it was not kept"  # noqa: S101
        return Target(rgb=self.photograph, alpha=self.alpha, name=self.name, camera=self.camera)


class Term:
    """What all terms may do beside saying how bad something is."""

    def begin(self, images: Sequence["TrainingImage"]) -> None:
        """A stage begins, in which these are the images: whoever compares views with one another keeps them."""
        return

    def parameter_groups(self) -> Sequence[ParameterGroup]:
        """What the term learns itself: the same parameters each time, from the first ``begin`` on."""
        return ()


class ImageLoss(Term, ABC):
    """A term of one view's rendering."""

    inner: ClassVar[bool] = False
    """The Gaussians learn their colours from it, in the inner loop (paper, eq. 12). A run needs such a term."""
    outline: ClassVar[bool] = False
    """It looks at masks alone: what a silhouette stage goes by (paper, 3.3)."""

    @abstractmethod
    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]: ...


class GeometryLoss(Term, ABC):
    """A term of the extracted surface and the field around it."""

    @abstractmethod
    def __call__(self, extraction: Extraction) -> Float[Tensor, ""]: ...


class ViewsLoss(Term, ABC):
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
