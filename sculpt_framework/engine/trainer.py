"""The bi-level loop (paper, 3.3): surfaces outside, Gaussians inside.

outer step   extract the surface with gradient, let the Gaussians follow its faces
  inner loop   optimise a detached copy of the Gaussians on colours and constraints, the surface held fixed
  copy back    the optimised values meet the connected surface again
render it, and carry the images' gradient through Gaussians and faces into field and extractor
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.adam import Adam
from sculpt_framework.binders import Binding
from sculpt_framework.config import StageConfig, TrainerConfig
from sculpt_framework.constraints import Constraint
from sculpt_framework.engine.gaussian_scene import GaussianScene, as_leaves, assemble, tensor_pairs
from sculpt_framework.engine.images import TrainingImage
from sculpt_framework.engine.parallel import Alone, Processes
from sculpt_framework.engine.regions import Frozen, Region, frozen_rows, signed_distance, untaught
from sculpt_framework.engine.resting import Resting
from sculpt_framework.engine.trust_region import TrustRegion
from sculpt_framework.extractors import Extraction, Extractor
from sculpt_framework.fields import Field
from sculpt_framework.losses import GeometryLoss, ImageLoss
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Gaussians, Rendering, Surface

Term = TypeVar("Term")
Drawn = tuple[TrainingImage, Float[Tensor, " 3"]]
"""A view, and what is behind it."""
_COLORS = "photometric"
"""The inner loop's image term, in what it tells."""
_CHUNK, _LEAST_WARM_UP = 10, 30
"""Colour steps between two looks at the clock while colours are warmed up, and those that there are in any case."""


@dataclass(frozen=True, kw_only=True)
class Weighted(Generic[Term]):
    """A term of an objective under the name and with the weight of its config."""

    name: str
    weight: float
    term: Term


@dataclass(frozen=True, kw_only=True, eq=False)
class Objectives:
    photometric: ImageLoss
    """The inner loop's image term."""
    images: Sequence[Weighted[ImageLoss]]
    silhouettes: Sequence[Weighted[ImageLoss]]
    """The image terms of a silhouette stage."""
    geometry: Sequence[Weighted[GeometryLoss]]
    constraints: Sequence[Weighted[Constraint]]


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """What one outer step did."""

    loss: float
    """The outer objective, mean over its views."""
    terms: dict[str, float]
    inner_loss: float | None
    faces: int
    gaussians: int
    step_kept: float
    """Share of the surface's step that the trust region left."""
    inner_seconds: float
    """What the inner loop took."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """The current surface with its Gaussians fitted to it: an outer step after its inner loop, before its update."""

    extraction: Extraction
    surface: Surface
    """The extracted one, without gradient where images teach nothing."""
    binding: Binding
    inner_loss: float | None
    inner_seconds: float


class BiLevelTrainer:
    """Runs outer steps. Owns the optimisers; what stage it is and when to stop is told from outside."""

    def __init__(
        self,
        *,
        field: Field,
        extractor: Extractor,
        scene: GaussianScene,
        rasterizer: Rasterizer,
        objectives: Objectives,
        config: TrainerConfig,
        generator: torch.Generator,
        processes: Processes | None = None,
    ):
        """``processes`` share the views of each step; None: there is one."""
        self.field = field
        self.extractor = extractor
        self.scene = scene
        groups = field.parameter_groups()
        self.optimizer = Adam([(group.parameters, group.rate) for group in groups], betas=(0.9, 0.99))
        self.seeds: Int64[Tensor, " s"] | None = None
        """Cells the surface was in after the latest extraction."""
        self.extraction: Extraction | None = None
        self.inner_total = 0
        self.frozen: list[Frozen] = []
        self.ignored: list[Region] = []
        """Where images teach nothing about the surface."""
        self.surface_rate = 1.0
        self.gaussian_rate = 1.0
        """Factors on the learning rates of the schedule."""
        self.trust = TrustRegion(config.trust_cells, [p for group in groups for p in group.parameters])
        self._rasterizer = rasterizer
        self.objectives = objectives
        self.resting = Resting(config.rest_after)
        self._config = config
        self._generator = generator
        self.processes = processes or Alone()
        self.view_order: list[int] = []
        """Views still to come before the next shuffle."""

    def equalize(self) -> None:
        """Have all processes start from the first one's field and colours: fitting rounds as the machine likes."""
        self.processes.equalize([*self.field.parameters(), *self.scene.appearance.parameters()])

    # -- the two levels: an outer step is settle, then update --------------------------------------------------

    def settle(
        self,
        images: Sequence[TrainingImage],
        stage: StageConfig,
        rate_factor: float,
        warm: Callable[[], bool] = lambda: False,
    ) -> Settled:
        """Extract the current surface and fit the Gaussians to it in the inner loop; rows and colours change.

        The first time colours are warmed up before, at full rates, until ``warm`` says that it has to be enough.

        Raises EmptySurfaceError, and FloatingPointError if the inner objective or a Gaussian is not finite.
        """
        extraction = self.extract()
        surface = untaught(self.ignored, extraction.surface)
        if not self._config.warm_start:
            self.scene.forget()
        self.scene.follow(surface)
        self.processes.require_same(surface.face_keys)
        inner_loss, binding, inner_began = None, None, time.perf_counter()
        if self._config.gradient_isolation and not stage.silhouette_only:
            if self.inner_total == 0:
                binding = self._warm_up(surface, images, warm)
            inner_loss, binding = self.inner_loop(surface, images, stage.inner_steps, rate_factor, binding)
        if binding is None:
            binding = self.scene.bind(surface, learn=not self._config.gradient_isolation)
        seconds = time.perf_counter() - inner_began
        self._check_scene()
        return Settled(
            extraction=extraction, surface=surface, binding=binding, inner_loss=inner_loss, inner_seconds=seconds
        )

    def update(
        self, settled: Settled, images: Sequence[TrainingImage], stage: StageConfig, rate_factor: float
    ) -> StepReport:
        """Carry the images' gradient through the settled Gaussians and faces into field and extractor.

        Raises FloatingPointError if the objective or its gradient is not finite; nothing has been updated then.
        """
        extraction, binding = settled.extraction, settled.binding
        views = stage.outer_views if self._config.gradient_isolation else stage.outer_views + stage.inner_steps
        self._zero_grad()
        joint = not self._config.gradient_isolation
        gaussians = assemble(binding, self.scene.harmonics(binding.means, degree=self._degree(0), learn=joint))
        seeing = self.objectives.silhouettes if stage.silhouette_only else self._awake()
        walk, terms = self._see(gaussians, [self._draw(images) for _ in range(views)], seeing)
        seen = tuple(terms)
        for objective in self.objectives.geometry:
            terms[objective.name] = walk.add(objective.weight * objective.term(extraction))
        # Without an inner loop there is no other place to constrain the Gaussians in.
        for constraint in self.objectives.constraints if joint and not stage.silhouette_only else ():
            terms[constraint.name] = walk.add(constraint.weight * constraint.term(binding))
        # One walk through extraction and field for all terms together: it costs as much as a render.
        walk.back()
        self._check_terms(terms)
        self._check_gradients()
        if not stage.silhouette_only:
            self._note_rest({name: terms[name] for name in seen})
        ramp = min(1.0, (self.optimizer.taken + 1) / self._config.ramp_steps)
        surface_rate = rate_factor * self.surface_rate * ramp
        before = self.trust.look(extraction, self.signed_distance)
        self.optimizer.step(surface_rate)
        for table in self.extractor.tables.values():
            table.step(surface_rate, still=frozen_rows(self.frozen, self.extractor.grid, table.keys))
        step_kept = self.trust.shorten(before, self.signed_distance, surface_rate)
        self._check_shape()
        if joint:
            self.scene.step(rate_factor * self.gaussian_rate)
        rows = [leaf for table in self.extractor.tables.values() for leaf in table.leaves.values()]
        self.processes.align([*self.optimizer.parameters, *rows, *self.scene.learning])
        return StepReport(
            loss=sum(terms.values()),
            terms=terms,
            inner_loss=settled.inner_loss,
            faces=settled.surface.faces.shape[0],
            gaussians=binding.opacities.numel(),
            step_kept=step_kept,
            inner_seconds=settled.inner_seconds,
        )

    def inner_loop(
        self,
        surface: Surface,
        images: Sequence[TrainingImage],
        steps: int,
        rate_factor: float,
        binding: Binding | None = None,
    ) -> tuple[float | None, Binding | None]:
        """Colours, and now and then scales and places, of the Gaussians on a detached copy of the surface.

        ``binding`` is what ``scene.bind`` makes of the surface, connected to it, if that is known. Returns the mean
        loss, None without steps, and that binding as it is then, None where places have been taught since.
        """
        total = 0.0
        batch = self._config.inner_batch or self.processes.count
        colors = [Weighted(name=_COLORS, weight=1.0, term=self.objectives.photometric)]
        for step in range(0, steps, batch):
            count = min(batch, steps - step)
            before, after = self.inner_total, self.inner_total + count
            every = self._config.bind_every
            # Places come first: colours, and the outer step, are then of one binding.
            learn_places = self.scene.learns_places and -(-before // every) < -(-after // every)
            if learn_places:
                bound, binding = self.scene.bind(surface.detach(), learn=True), None
            else:
                binding = self.scene.bind(surface, learn=False) if binding is None else binding
                bound = binding.detach()
            self.scene.zero_grad()
            gaussians = assemble(bound, self.scene.harmonics(bound.means, degree=self._degree(step), learn=True))
            walk, terms = self._see(gaussians, [self._draw(images) for _ in range(count)], colors)
            awake = [each for each in self.objectives.constraints if learn_places and self.resting.due(each.name)]
            for constraint in awake:
                terms[constraint.name] = walk.add(constraint.weight * constraint.term(bound))
            walk.back()
            self._check_terms(terms)
            for constraint in awake:
                self.resting.saw(constraint.name, terms[constraint.name], terms[_COLORS])
            total += terms[_COLORS] * count
            self.scene.step(self.gaussian_rate * (1.0 if not self._config.warm_start else rate_factor))
            self.inner_total = after
        return (total / steps if steps else None), binding

    def _warm_up(self, surface: Surface, images: Sequence[TrainingImage], warm: Callable[[], bool]) -> Binding | None:
        """Inner steps before the surface first moves. Returns a binding as ``inner_loop`` does."""
        steps, chunk = self._config.warm_up_steps, _CHUNK * (self._config.inner_batch or self.processes.count)
        binding: Binding | None = None
        for done in range(0, steps, chunk):
            if done >= _LEAST_WARM_UP and self.processes.first(warm):
                break
            _, binding = self.inner_loop(surface, images, min(chunk, steps - done), 1.0, binding)
        return binding

    def signed_distance(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        return signed_distance(self.field, self.frozen, points, margin=2 * self.extractor.grid.cell)

    # -- parts of an outer step ----------------------------------------------------------------------------------

    def extract(self) -> Extraction:
        """The current surface, connected to field and extractor. Raises EmptySurfaceError."""
        assert self.seeds is not None, "the first seeds come from outside"  # noqa: S101
        self.extraction = self.extractor.extract(self.signed_distance, self.seeds)
        self.seeds = self.extraction.cells
        return self.extraction

    def _see(
        self, gaussians: Gaussians, drawn: Sequence[Drawn], objectives: Sequence[Weighted[ImageLoss]]
    ) -> tuple["_Walk", dict[str, float]]:
        """The mean gradient of the views' image terms by the Gaussians, from where it goes on, and the terms.

        Each view's graph ends at the Gaussians and is freed before the next view is rendered. That is where processes
        add up: Gaussians have far fewer numbers than what they are made of, and from here all go on alike.
        """
        leaves = as_leaves(gaussians)
        terms = {objective.name: 0.0 for objective in objectives}
        for number in self.processes.share(len(drawn)):
            image, background = drawn[number]
            rendering, target = self._render(leaves, image, background), image.over(background)
            loss = rendering.alpha.new_zeros(())
            for objective in objectives:
                term = objective.weight * objective.term(rendering, target)
                terms[objective.name] += float(term.detach()) / len(drawn)
                loss = loss + term
            if loss.requires_grad:
                (loss / len(drawn)).backward()
        pairs = [(value, leaf) for value, leaf in tensor_pairs(gaussians, leaves) if leaf.requires_grad]
        terms = self.processes.reduce([leaf for _, leaf in pairs], terms)
        walk = _Walk()
        for value, leaf in pairs:
            if leaf.grad is not None:
                walk.roots.append(value)
                walk.gradients.append(leaf.grad)
        return walk, terms

    def _note_rest(self, terms: Mapping[str, float]) -> None:
        """Of image terms, what they came to."""
        for objective in self.objectives.images:
            if objective.name in terms and objective.term is not self.objectives.photometric:
                self.resting.saw(objective.name, terms[objective.name], sum(terms.values()))

    def _awake(self) -> Sequence[Weighted[ImageLoss]]:
        """The image terms that are evaluated in this step: what compares colours always is."""
        always = self.objectives.photometric
        return [each for each in self.objectives.images if each.term is always or self.resting.due(each.name)]

    def _render(self, gaussians: Gaussians, image: TrainingImage, background: Float[Tensor, " 3"]) -> Rendering:
        return self._rasterizer.render(
            gaussians, image.camera, background, low_pass_px2=self._config.low_pass_px2, normals=False
        )

    def _zero_grad(self) -> None:
        self.optimizer.zero_grad()
        self.scene.zero_grad()
        for table in self.extractor.tables.values():
            table.zero_grad()

    def _check_terms(self, terms: Mapping[str, float]) -> None:
        broken = [f"{name} is {value}" for name, value in terms.items() if not math.isfinite(value)]
        if broken:
            # Their cause, if it is in what the Gaussians are made of, says more.
            self._check_scene()
            raise FloatingPointError(f"the objective is not finite: {', '.join(broken)}")

    def _check_scene(self) -> None:
        """Of the Gaussians. One that is not finite would not be drawn: a hole that no image complains about."""
        for owner, table in (("binder", self.scene.geometry_rows), ("appearance", self.scene.appearance_rows)):
            for name, leaf in table.leaves.items():
                _require_finite(leaf, f"the {owner}'s {name}")
        for parameter in self.scene.appearance.parameters():
            _require_finite(parameter, "the appearance")

    def _check_shape(self) -> None:
        """Of field and extractor, after they have been updated."""
        for parameter in self.optimizer.parameters:
            _require_finite(parameter, "the field")
        for name, table in self.extractor.tables.items():
            for leaf in table.leaves.values():
                _require_finite(leaf, f"the extractor's {name}")

    def _check_gradients(self) -> None:
        """Of field and extractor, before anything is updated by them."""
        named: list[tuple[str, Tensor]] = [("the field", parameter) for parameter in self.optimizer.parameters]
        for name, table in self.extractor.tables.items():
            named += [(f"the extractor's {name}", leaf) for leaf in table.leaves.values()]
        for name, tensor in named:
            if tensor.grad is not None:
                _require_finite(tensor.grad, f"the gradient of {name}")

    def _degree(self, step: int) -> int:
        """Active spherical-harmonics degree: one more every so many inner steps (3DGS), from the Gaussians' start."""
        steps = self.inner_total if self._config.warm_start else step
        return steps // self._config.sh_degree_every

    def _next_view(self, count: int) -> int:
        """Every view once, in random order, before any comes again."""
        if not self.view_order:
            self.view_order = torch.randperm(count, generator=self._generator).tolist()
        return self.view_order.pop()

    def _draw(self, images: Sequence[TrainingImage]) -> Drawn:
        """The next view. Every process draws for all, so that all draw the same."""
        image = images[self._next_view(len(images))]
        return image, self._background(image)

    def _background(self, image: TrainingImage) -> Float[Tensor, " 3"]:
        if self._config.random_background and image.alpha is not None:
            return torch.rand(3, generator=self._generator).to(image.premultiplied)
        return torch.ones(3).to(image.premultiplied)


class _Walk:
    """Tensors that a walk back through a graph starts from, each with its gradient."""

    def __init__(self) -> None:
        self.roots: list[Tensor] = []
        self.gradients: list[Tensor] = []

    def add(self, term: Float[Tensor, ""]) -> float:
        """Start from this term, too, if anything can learn from it. Returns its value."""
        if term.requires_grad:
            self.roots.append(term)
            self.gradients.append(torch.ones_like(term))
        return float(term.detach())

    def back(self) -> None:
        if self.roots:
            torch.autograd.backward(self.roots, self.gradients)


def _require_finite(tensor: Tensor, what: str) -> None:
    # One sum is a quarter of the cost of testing every element, and not finite if any element is not.
    if not bool(torch.isfinite(tensor.detach().sum())):
        raise FloatingPointError(f"{what} is not finite")
