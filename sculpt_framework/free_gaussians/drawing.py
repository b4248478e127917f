"""How a method draws its Gaussians, and what it learns from a drawing."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.losses import Target, TrainingImage
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.types import Camera, Gaussians, Rendering

Terms = dict[str, Float[Tensor, ""]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Lesson:
    """One view to learn from."""

    camera: Camera
    background: Float[Tensor, " 3"]
    target: Target
    """Over that background."""
    progress: float
    """Share of the run that is done."""
    generator: torch.Generator
    """What is random follows it."""


class Drawing(ABC):
    """Gaussians and camera in the object frame."""

    @abstractmethod
    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering: ...

    def begin(self, images: Sequence[TrainingImage]) -> None:
        """These are the images that are learned from: whoever compares views with one another keeps them."""
        return

    @abstractmethod
    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        """What is learned from one view: the sum of these is the loss."""


class Splatting(Drawing):
    """By a rasterizer, as ellipsoids; the colour loss of 3DGS."""

    def __init__(self, rasterizer: Rasterizer, low_pass_px2: float, dssim: float):
        self._rasterizer, self._low_pass, self._dssim = rasterizer, low_pass_px2, dssim

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return self._rasterizer.render(gaussians, camera, background, low_pass_px2=self._low_pass)

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        rendering = self.draw(gaussians, lesson.camera, lesson.background)
        return {"color": l1_dssim(rendering.rgb, lesson.target.rgb, self._dssim)}


@torch.no_grad()
def on_white(drawing: Drawing, gaussians: Gaussians, camera: Camera) -> Rendering:
    return drawing.draw(gaussians, camera, torch.ones(3, device=gaussians.means.device))
