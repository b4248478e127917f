"""What the bi-level method may be told. Free of torch, as all configs are."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from sculpt_framework.config import (
    AppearanceConfig,
    BackgroundConfig,
    BinderConfig,
    ConstraintConfig,
    ExtractorConfig,
    FieldConfig,
    InitializerConfig,
    LossConfig,
    MethodConfig,
    NoBackgroundConfig,
    RasterizerConfig,
)
from sculpt_framework.errors import ConfigError
from sculpt_framework.ranges import above, at_least, between, require

if TYPE_CHECKING:
    from sculpt_framework.engine.checkpoint import Saved
    from sculpt_framework.plan.decision import ScenePlan
    from sculpt_framework.reconstructor import Host, Reconstructor
    from sculpt_framework.types import Camera, Rendering, Scene


@dataclass(frozen=True, kw_only=True)
class StageConfig:
    """A stretch of training at one grid level and one image size."""

    GONE: ClassVar = {"time_share": None}

    share: Annotated[float, above(0)]
    """Share of the outer steps, or of the time under ``--max-time``, that this stage takes; relative."""
    level: Annotated[int, between(0, 10)]
    """Grid level: cells are halved with each level."""
    image_scale: Annotated[float, above(0, at_most=1)]
    """Side of the training images relative to the input, in (0, 1]."""
    inner_steps: Annotated[int, at_least(0)]
    """Inner (Gaussian) steps per outer step, one view each."""
    outer_views: Annotated[int, at_least(1)]
    """Views whose gradients one outer (surface) step adds up."""
    silhouette_only: bool = False
    """Shape by silhouettes alone, before colours count (paper, 3.3)."""


@dataclass(frozen=True, kw_only=True)
class TrainerConfig:
    """The bi-level loop."""

    stages: tuple[StageConfig, ...]
    """Coarse to fine."""
    base_cells: Annotated[int, at_least(2)]
    """Grid cells along the longest side of the object's box at level 0."""
    cell_pixels: Annotated[float | None, above(0, at_most=1000)] = None
    """Width that cells have at least, in pixels of the stage's image that shows them best: where the stage's cells are
    narrower, larger ones take their place. Default: all cells of a stage are alike."""
    final_rate: Annotated[float, above(0, at_most=1)] = 0.05
    """Share of their start to which learning rates fall, exponentially, over the run."""
    surface_steps: Annotated[float, at_least(0)] = 0.0
    """What the surface's rates, as shares of their start, add up to over the run at most: the longer it is, the sooner
    they fall, so that time goes into refining. 0: no bound."""
    gradient_isolation: bool = True
    """Optimise a detached copy of the Gaussians in the inner loop; off: one joint update of everything (ablation)."""
    warm_start: bool = True
    """Keep each face's Gaussian parameters and optimiser state across outer steps; off: start anew (paper)."""
    inner_batch: Annotated[int | None, at_least(1)] = None
    """Views that one inner step takes together; there are as many fewer steps. Default: as many as there are processes
    (torchrun), so one alone takes one; a resumed run keeps its number."""
    bind_every: Annotated[int, at_least(1)] = 4
    """Places, scales and rotations of the Gaussians learn in every so many inner steps; colours in all."""
    sh_degree_every: Annotated[int, at_least(1)] = 1000
    """Inner steps after which one more degree of spherical harmonics becomes active (3DGS: 1000)."""
    low_pass_px2: Annotated[float, at_least(0)] = 0.05
    """Variance added to every splat on the screen, in square pixels (3DGS: 0.3)."""
    random_background: bool = True
    """Compose images over a new random colour each step; off: over white."""
    fit_steps: Annotated[int, at_least(0)] = 200
    """Steps of fitting the field to the initial surface."""
    warm_up_steps: Annotated[int, at_least(0)] = 0
    """Inner steps before the surface first moves: what has no colour yet pulls it wrong ways. Under a time limit they
    take a quarter of it at most."""
    ramp_steps: Annotated[int, at_least(1)] = 1
    """Outer steps over which the surface's rates grow to their full size: Adam's first steps are as long for noise as
    for what matters, and would roughen a good start."""
    trust_cells: Annotated[float, at_least(0)] = 0.0
    """How far one step may move the surface, in cells of the stage, where it moves farthest (all but 5 % of it), times
    the learning rates' share of their start: a longer step is shortened. 0: as far as the rates take it."""
    polish_steps: Annotated[int, at_least(0)] = 100
    """Inner steps on the final surface, for the colours that are saved."""
    polish_gaussians: Annotated[int, between(1, 12)] = 1
    """Gaussians on a face from then on, if the binder has fewer: colours finer than faces."""
    polish_rate: Annotated[float, above(0)] = 0.3
    """Learning rates of then, times those a run begins with; they fall to ``final_rate`` times those, if that is less.
    More than 0.3 unsettles colours that are nearly right; those that have only followed the surface need 3."""
    polish_gain_db: Annotated[float, at_least(0)] = 0.0
    """Stop that once twenty steps gain less than the twenty before on two held-out views; 0: never."""
    rest_after: Annotated[int, at_least(0)] = 0
    """Evaluations without effect after which a term of an objective rests, tried again every so many; 0: never."""

    @property
    def finest_level(self) -> int:
        """Of the stages' grids."""
        return max(stage.level for stage in self.stages)

    @property
    def finest_cells(self) -> int:
        """Cells along the longest side of the object's box, on that level."""
        return self.base_cells << self.finest_level


Switch = Literal["on", "off"]
_NO_BACKGROUND = NoBackgroundConfig()


@dataclass(frozen=True, kw_only=True)
class PlanConfig:
    """What a run decides by itself from what the scene's data show (docs/background/plan.md).

    An item that is None follows ``mode``; ``off`` leaves it as the method and the command line have it. What the
    command line has set otherwise than the method is never decided.
    """

    mode: Switch = "off"
    """Decide the items that say nothing themselves."""
    silhouette: Switch | None = None
    """Silhouette loss and start, by whether there are masks."""
    stereo: Switch | None = None
    """Depths before training, by whether colours say anything, and whether images agree in them."""
    light: Switch | None = None
    """How far the surface may move in training, by how much the light differs between images."""
    views: Switch | None = None
    """Views that see nothing or repeat another one."""
    level: Switch | None = None
    """The width of cells, by that of a pixel on the surface and of the thinnest part."""
    images: Switch | None = None
    """The size of the images, by the width of a cell in them."""
    refinement: Switch | None = None
    """Larger cells where the images show less, by how the width of a pixel varies."""
    sh_degree: Switch | None = None
    """Degree of the colours' spherical harmonics, by how colours change with the view."""
    gaussians: Switch | None = None
    """K per face, by the texture finer than a face."""
    constraints: Switch | None = None
    """Constraints that cannot act, or turn out not to."""
    places: Switch | None = None
    """Whether Gaussians learn their places and sizes on their faces, by the width of a face in the images."""
    inner_steps: Switch | None = None
    """Colour steps before and between two steps of the surface, by the texture."""
    polish: Switch | None = None
    """Colour steps after the last step of the surface, until they gain nothing."""

    @property
    def items(self) -> tuple[str, ...]:
        """Names of the items to be decided, as the fields'."""
        own = {each.name: getattr(self, each.name) for each in fields(PlanConfig) if each.name != "mode"}
        return tuple(item for item, switch in own.items() if (switch or self.mode) == "on")


@dataclass(frozen=True, kw_only=True)
class SculptingConfig(MethodConfig):
    """A signed distance sculpted through Gaussians on its surface (paper, 3)."""

    refine_box: tuple[tuple[float, float, float, float, float, float], ...] = ()
    """A box in world frame in which the surface gets finer cells; for several, give the option several times."""
    refine_box_levels: Annotated[int, between(1, 6)] = 1
    """How many times cells are halved in these boxes."""
    repair: Path | None = None
    """A finished run that this one goes on with in these boxes; outside, its surface stays. Set by ``--resume``."""
    field: FieldConfig
    extractor: ExtractorConfig
    binder: BinderConfig
    appearance: AppearanceConfig
    rasterizer: RasterizerConfig
    background: BackgroundConfig = _NO_BACKGROUND
    initializer: InitializerConfig
    losses: tuple[LossConfig, ...]
    constraints: tuple[ConstraintConfig, ...]
    trainer: TrainerConfig
    plan: PlanConfig = PlanConfig()
    """What to decide from the scene's data."""

    def build(self, scene: "Scene", host: "Host") -> "Reconstructor":
        from sculpt_framework.sculpting.method import Sculpting

        return Sculpting(self, scene, host)

    def check(self) -> None:
        for low, high in ((box[:3], box[3:]) for box in self.refine_box):
            given = " ".join(f"{number:g}" for number in (*low, *high))
            holds = all(a < b for a, b in zip(low, high, strict=True))
            require(holds, "refine-box", given, "X0 < X1, Y0 < Y1, Z0 < Z1")
        if not self.trainer.stages:
            raise ConfigError("the method has no stages; a run needs at least one.")

    def short_words(self) -> tuple[str, ...]:
        """A step or so of every stage."""
        words = ["--steps", "4", "--trainer.fit-steps", "5", "--trainer.polish-steps", "2"]
        for index in range(len(self.trainer.stages)):
            words += [f"--trainer.stages.{index}.inner-steps", "1", f"--trainer.stages.{index}.outer-views", "1"]
        return tuple(words)

    def planned(self, scene: "Scene") -> "tuple[MethodConfig, ScenePlan | None]":
        if not self.plan.items:
            return self, None
        from sculpt_framework.plan.make import plan_scene

        return plan_scene(self, scene)

    def among(self, processes: int) -> "SculptingConfig":
        if processes == 1:
            return self
        batch = self.trainer.inner_batch or processes
        return replace(self, trainer=replace(self.trainer, inner_batch=batch))

    def check_start(self) -> None:
        if self.repair is not None:
            from sculpt_framework.engine.run import require_finished

            require_finished(self.repair)

    def start(self, scene: "Scene") -> "Saved | None":
        if self.repair is None:
            return None
        from sculpt_framework.sculpting.repair import start_of_repair

        return start_of_repair(self, self.repair, scene)

    def renderer(self, folder: Path, scene: "Scene") -> "Callable[[Camera], Rendering]":
        from sculpt_framework.export.saved_gaussians import draw_saved_gaussians

        return draw_saved_gaussians(self, self.rasterizer, self.trainer.low_pass_px2, folder, scene)


def of_sculpting(config: MethodConfig) -> SculptingConfig:
    """The config, if it is one of this kind of method. Raises ConfigError if not."""
    if not isinstance(config, SculptingConfig):
        raise ConfigError(f"{config.method!r} has no field, extractor and Gaussians; choose a method that has.")
    return config
