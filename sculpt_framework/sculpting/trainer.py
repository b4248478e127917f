"""The bi-level loop (paper, 3.3): surfaces outside, Gaussians inside.

outer step   extract the surface with gradient, let the Gaussians follow its faces
  inner loop   optimise a detached copy of the Gaussians on colours and constraints, the surface held fixed
  copy back    the optimised values meet the connected surface again
render it, and carry the images' gradient through Gaussians and faces into field and extractor
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from sculpt_framework.adam import Adam
from sculpt_framework.backgrounds import Background
from sculpt_framework.binders import Binding
from sculpt_framework.constraints import Constraint
from sculpt_framework.extractors import Extraction, Extractor
from sculpt_framework.fields import Field
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.losses import GeometryLoss, ImageLoss, Term, TrainingImage, ViewsLoss
from sculpt_framework.parallel.processes import Alone, Processes
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.sculpting.boxes import FrozenField, frozen_rows, signed_distance, untaught
from sculpt_framework.sculpting.config import StageConfig, TrainerConfig
from sculpt_framework.sculpting.gaussian_scene import GaussianScene, assemble
from sculpt_framework.sculpting.own_parameters import OwnParameters
from sculpt_framework.sculpting.term_gating import TermGating
from sculpt_framework.sculpting.trust_region import TrustRegion
from sculpt_framework.sculpting.view_gradients import DeferredBackward, ViewGradients, Weighted
from sculpt_framework.types import Box, Gaussians, Surface

_CHUNK, _LEAST_WARM_UP = 10, 30
"""Colour steps between two looks at the clock while colours are warmed up, and those that there are in any case."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Objectives:
    inner: Weighted[ImageLoss]
    """The inner loop's image term."""
    images: Sequence[Weighted[ImageLoss]]
    silhouettes: Sequence[Weighted[ImageLoss]]
    """The image terms of a silhouette stage."""
    geometry: Sequence[Weighted[GeometryLoss]]
    views: Sequence[Weighted[ViewsLoss]]
    constraints: Sequence[Weighted[Constraint]]

    @property
    def terms(self) -> list[Term]:
        """Each once."""
        return [each.term for each in (*self.images, *self.geometry, *self.views, *self.constraints)]


@dataclass(frozen=True, kw_only=True)
class OuterStep:
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
        background: Background | None = None,
    ):
        """``processes`` share the views of each step; None: there is one. ``background``: what is around the object;
        None: masks leave it out."""
        self.field = field
        self.extractor = extractor
        self.scene = scene
        self.background = background
        groups = field.parameter_groups()
        self.optimizer = Adam(groups, betas=(0.9, 0.99))
        self.seeds: Int64[Tensor, " s"] | None = None
        """Cells the surface was in after the latest extraction."""
        self.extraction: Extraction | None = None
        self.inner_total = 0
        self.frozen: list[FrozenField] = []
        self.signed_distance: SdfFunction = self._free_distance
        """What is extracted: what the field says, within what bounds the object."""
        self.ignored: list[Box] = []
        """Where images teach nothing about the surface."""
        self.surface_rate = 1.0
        self.gaussian_rate = 1.0
        """Factors on the learning rates of the schedule."""
        self.trust = TrustRegion(config.trust_cells, [p for group in groups for p in group.parameters])
        self.objectives = objectives
        self.own = OwnParameters(objectives.terms)
        self.gating = TermGating(config.rest_after)
        self._config = config
        self.processes = processes or Alone()
        self.views = ViewGradients(rasterizer, config, generator)

    def equalize(self) -> None:
        """Have all processes start from the first one's field and colours: fitting rounds as the machine likes."""
        self.processes.equalize([*self.field.parameters(), *self.scene.appearance.parameters(), *self._behind])

    def take_images(self, images: Sequence[TrainingImage]) -> None:
        """From here on these are the images that the steps are given."""
        self.own.begin(images)

    def begin_stage(self) -> None:
        """Images are others from here on: views come in a new order."""
        self.views.order = []

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
    ) -> OuterStep:
        """Carry the images' gradient through the settled Gaussians and faces into field and extractor.

        Raises FloatingPointError if the objective or its gradient is not finite; nothing has been updated then.
        """
        extraction, binding = settled.extraction, settled.binding
        views = stage.outer_views if self._config.gradient_isolation else stage.outer_views + stage.inner_steps
        self._zero_grad()
        joint = not self._config.gradient_isolation
        degree = self._degree(stage.inner_steps)
        if joint:  # Without an inner loop it goes by the views that have been looked at.
            degree = self.optimizer.taken * views // self._config.sh_degree_every
        gaussians = assemble(binding, self.scene.harmonics(binding.means, degree=degree, learn=joint))
        seeing = self.objectives.silhouettes if stage.silhouette_only else self._awake()
        around = None if stage.silhouette_only else self._around(learn=joint)
        deferred, terms = self.views.render_and_backward(
            gaussians, images, views, seeing, self.processes, self.own, around
        )
        seen = tuple(terms)
        compared = [each for each in self.objectives.views if each.weight > 0 and not stage.silhouette_only]
        for objective in compared:
            terms[objective.name] = self._compare(objective, settled.surface, images, deferred)
        for objective in self.objectives.geometry:
            terms[objective.name] = deferred.add(objective.weight * objective.term(extraction))
        # Without an inner loop there is no other place to constrain the Gaussians in.
        for constraint in self.objectives.constraints if joint and not stage.silhouette_only else ():
            terms[constraint.name] = deferred.add(constraint.weight * constraint.term(binding))
        # One pass back through extraction and field for all terms together: it costs as much as a render.
        deferred.backward()
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
        self.own.step(rate_factor)
        if joint:
            self.scene.step(rate_factor * self.gaussian_rate)
            if self.background is not None and not stage.silhouette_only:
                self.background.step(rate_factor * self.gaussian_rate)
        rows = [leaf for table in self.extractor.tables.values() for leaf in table.leaves.values()]
        self.processes.align(
            [*self.optimizer.parameters, *rows, *self.scene.learning, *self._behind, *self.own.parameters]
        )
        return OuterStep(
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
        inner = replace(self.objectives.inner, weight=1.0)
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
            degree = self._degree(step)
            sh = self.scene.harmonics(bound.means, degree=degree, learn=True)
            deferred, terms = self.views.render_and_backward(
                assemble(bound, sh), images, count, [inner], self.processes, self.own, self._around(learn=True)
            )
            awake = [each for each in self.objectives.constraints if learn_places and self.gating.due(each.name)]
            for constraint in awake:
                terms[constraint.name] = deferred.add(constraint.weight * constraint.term(bound))
            deferred.backward()
            self._check_terms(terms)
            for constraint in awake:
                self.gating.saw(constraint.name, terms[constraint.name], terms[inner.name])
            total += terms[inner.name] * count
            rate = self.gaussian_rate * (1.0 if not self._config.warm_start else rate_factor)
            self.scene.step(rate)
            self.own.step(rate)
            if self.background is not None:
                self.background.step(rate)
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

    def _free_distance(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        return signed_distance(self.field, self.frozen, points, margin=2 * self.extractor.grid.cell)

    def _compare(
        self,
        objective: Weighted[ViewsLoss],
        surface: Surface,
        images: Sequence[TrainingImage],
        deferred: DeferredBackward,
    ) -> float:
        """A term of surface and photographs; each process does its share of the views. Returns its value."""
        drawn = [self.views.next_view(len(images)) for _ in range(objective.term.views)]
        mine = [drawn[number] for number in self.processes.share(len(drawn))]
        leaf, value = surface.vertices.detach().requires_grad_(), 0.0
        if mine:
            mean = objective.term(replace(surface, vertices=leaf), mine, self.optimizer.taken)
            term = objective.weight * len(mine) / len(drawn) * mean
            value = float(term.detach())
            if term.requires_grad:
                term.backward()
        own = [parameter for group in objective.term.parameter_groups() for parameter in group.parameters]
        (value,) = self.processes.reduce([leaf, *own], {objective.name: value}).values()
        if leaf.grad is not None and surface.vertices.requires_grad:
            deferred.roots.append(surface.vertices)
            deferred.gradients.append(leaf.grad)
        return value

    # -- parts of an outer step ----------------------------------------------------------------------------------

    def extract(self) -> Extraction:
        """The current surface, connected to field and extractor. Raises EmptySurfaceError."""
        assert self.seeds is not None, "the first seeds come from outside"  # noqa: S101
        self.extraction = self.extractor.extract(self.signed_distance, self.seeds)
        self.seeds = self.extraction.cells
        return self.extraction

    def _around(self, *, learn: bool) -> Gaussians | None:
        """What is behind the object; None where nothing is. Its gradient begins anew if it is to ``learn``."""
        if self.background is None:
            return None
        if learn:
            self.background.zero_grad()
        with torch.set_grad_enabled(learn):
            return self.background.gaussians()

    @property
    def _behind(self) -> list[nn.Parameter]:
        return [] if self.background is None else self.background.parameters

    def _note_rest(self, terms: Mapping[str, float]) -> None:
        """Of image terms, what they came to."""
        for objective in self.objectives.images:
            if objective.name in terms and objective.term is not self.objectives.inner.term:
                self.gating.saw(objective.name, terms[objective.name], sum(terms.values()))

    def _awake(self) -> Sequence[Weighted[ImageLoss]]:
        """The image terms that are evaluated in this step: what compares colours always is, if it has a weight."""
        always, weighty = self.objectives.inner.term, [each for each in self.objectives.images if each.weight > 0]
        return [each for each in weighty if each.term is always or self.gating.due(each.name)]

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
        for parameter in self._behind:
            _require_finite(parameter, "the background")

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


def _require_finite(tensor: Tensor, what: str) -> None:
    # One sum is a quarter of the cost of testing every element, and not finite if any element is not.
    if not bool(torch.isfinite(tensor.detach().sum())):
        raise FloatingPointError(f"{what} is not finite")
