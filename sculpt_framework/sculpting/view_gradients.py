"""Views in random order, and what they say of the Gaussians: the part of a step that rendering is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.losses import ImageLoss, Target, TrainingImage
from sculpt_framework.parallel.processes import Processes
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.sculpting.config import TrainerConfig
from sculpt_framework.sculpting.gaussian_scene import as_leaves, tensor_pairs
from sculpt_framework.sculpting.own_parameters import OwnParameters
from sculpt_framework.types import Gaussians, Rendering

Term = TypeVar("Term")
Drawn = tuple[TrainingImage, Float[Tensor, " 3"]]
"""A view, and what is behind it."""


@dataclass(frozen=True, kw_only=True)
class Weighted(Generic[Term]):
    """A term of an objective under the name and with the weight of its config."""

    name: str
    weight: float
    term: Term


class ViewGradients:
    """Draws views, renders Gaussians into them and gathers the gradient of image terms at the Gaussians."""

    def __init__(self, rasterizer: Rasterizer, config: TrainerConfig, generator: torch.Generator):
        self.order: list[int] = []
        """Views still to come before the next shuffle."""
        self._rasterizer = rasterizer
        self._config = config
        self._generator = generator

    def render_and_backward(
        self,
        gaussians: Gaussians,
        images: Sequence[TrainingImage],
        count: int,
        objectives: Sequence[Weighted[ImageLoss]],
        processes: Processes,
        own: OwnParameters,
        around: Gaussians | None = None,
    ) -> tuple["DeferredBackward", dict[str, float]]:
        """The mean gradient of the next views' image terms by the Gaussians, from where it goes on, and the terms.

        Where there are Gaussians of what is ``around`` the object, behind it in every view, whole photographs are
        compared.

        Each view's graph ends at the Gaussians and is freed before the next view is rendered. That is where processes
        add up: Gaussians have far fewer numbers than what they are made of, and from here all go on alike. What terms
        learn themselves (``own``) has its gradient from these views alone.
        """
        drawn = [self._draw(images) for _ in range(count if objectives else 0)]
        connected = [gaussians] if around is None else [gaussians, around]
        leaves = [as_leaves(each) for each in connected]
        own.zero_grad()
        terms = {objective.name: 0.0 for objective in objectives}
        for number in processes.share(len(drawn)):
            rendering, target = self._seen(*drawn[number], *leaves)
            loss = rendering.alpha.new_zeros(())
            for objective in objectives:
                term = objective.weight * objective.term(rendering, target)
                terms[objective.name] += float(term.detach()) / len(drawn)
                loss = loss + term
            if loss.requires_grad:
                (loss / len(drawn)).backward()
        both = zip(connected, leaves, strict=True)
        pairs = [pair for each, own_leaves in both for pair in tensor_pairs(each, own_leaves) if pair[1].requires_grad]
        terms = processes.reduce([*(leaf for _, leaf in pairs), *own.parameters], terms)
        deferred = DeferredBackward()
        for value, leaf in pairs:
            if leaf.grad is not None:
                deferred.roots.append(value)
                deferred.gradients.append(leaf.grad)
        return deferred, terms

    def next_view(self, count: int) -> int:
        """Every view once, in random order, before any comes again."""
        if not self.order:
            self.order = torch.randperm(count, generator=self._generator).tolist()
        return self.order.pop()

    def _seen(
        self,
        image: TrainingImage,
        background: Float[Tensor, " 3"],
        gaussians: Gaussians,
        around: Gaussians | None = None,
    ) -> tuple[Rendering, Target]:
        """How a view renders, its alpha that of the object alone, and what it is compared with."""
        low_pass = self._config.low_pass_px2
        if around is None:
            rendering = self._rasterizer.render(gaussians, image.camera, background, low_pass_px2=low_pass)
            return rendering, image.over(background)
        black = torch.zeros_like(background)
        rendering = self._rasterizer.render(gaussians, image.camera, black, low_pass_px2=low_pass)
        room = self._rasterizer.render(around, image.camera, black, low_pass_px2=low_pass)
        rgb = rendering.rgb + (1 - rendering.alpha)[..., None] * room.rgb
        return replace(rendering, rgb=rgb), image.whole()

    def _draw(self, images: Sequence[TrainingImage]) -> Drawn:
        """The next view. Every process draws for all, so that all draw the same."""
        image = images[self.next_view(len(images))]
        return image, self._background(image)

    def _background(self, image: TrainingImage) -> Float[Tensor, " 3"]:
        if self._config.random_background and image.alpha is not None:
            return torch.rand(3, generator=self._generator).to(image.premultiplied)
        return torch.ones(3).to(image.premultiplied)


class DeferredBackward:
    """Tensors that one pass back through a graph starts from, each with its gradient."""

    def __init__(self) -> None:
        self.roots: list[Tensor] = []
        self.gradients: list[Tensor] = []

    def add(self, term: Float[Tensor, ""]) -> float:
        """Start from this term, too, if anything can learn from it. Returns its value."""
        if term.requires_grad:
            self.roots.append(term)
            self.gradients.append(torch.ones_like(term))
        return float(term.detach())

    def backward(self) -> None:
        if self.roots:
            torch.autograd.backward(self.roots, self.gradients)
