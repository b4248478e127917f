"""From a config to the components it names."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from sculpt_framework.device import pick_device
from sculpt_framework.errors import ConfigError
from sculpt_framework.extractors import Extractor, RefiningExtractor
from sculpt_framework.geometry.band import cells_at_level, coarsened, discover
from sculpt_framework.geometry.grid import Grid, grid_over_box
from sculpt_framework.geometry.octree_policy import LevelMap, RefineBox, level_map, wanted_levels
from sculpt_framework.losses import GeometryLoss, ImageLoss, TrainingImage, ViewsLoss
from sculpt_framework.parallel.processes import Processes
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.registry import name_of
from sculpt_framework.sculpting.boxes import object_box
from sculpt_framework.sculpting.config import SculptingConfig, TrainerConfig
from sculpt_framework.sculpting.gaussian_scene import GaussianScene
from sculpt_framework.sculpting.trainer import BiLevelTrainer, Objectives, Weighted
from sculpt_framework.types import Box

PHOTOMETRIC, SILHOUETTE = "photometric", "silhouette"
_LIPSCHITZ = 1.5
"""A fitted field is not quite a distance: cells are searched as if it could be this much steeper."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Parts:
    """The components of a run, wired up."""

    device: torch.device
    grid: Grid
    """At level 0; stages say which level they work on."""
    refinement: int
    """How many of the smallest cells of a box that is refined a cell of the grid is wide; 1 without boxes."""
    rasterizer: Rasterizer
    trainer: BiLevelTrainer

    @property
    def detail(self) -> float:
        """The size of the smallest cells, object units, which the field is told."""
        return self.trainer.extractor.grid.cell / self.refinement


def build_parts(
    config: SculptingConfig, box: Box, generator: torch.Generator, processes: Processes | None = None
) -> Parts:
    """Build every component. Parameters are drawn from torch's own generator, seeded here with the run's seed."""
    device = pick_device(config.device)
    trainer = config.trainer
    grid = grid_over_box(box.half_sides, trainer.base_cells)
    rasterizer = config.rasterizer.build(device)
    # The caller's own random numbers go on as if there had been no run.
    with torch.random.fork_rng([device] if device.type == "cuda" else []):
        torch.manual_seed(config.seed)
        field = config.field.build(trainer.finest_cells, device)
        scene = GaussianScene(config.binder.build(), config.appearance.build(device))
    return Parts(
        device=device,
        grid=grid,
        refinement=1 << config.refine_box_levels if config.refine_box else 1,
        rasterizer=rasterizer,
        trainer=BiLevelTrainer(
            field=field,
            extractor=build_extractor(config, box, grid, device),
            scene=scene,
            rasterizer=rasterizer,
            objectives=build_objectives(config),
            config=trainer,
            generator=generator,
            processes=processes,
            background=config.background.build(device),
        ),
    )


def build_extractor(config: SculptingConfig, box: Box, grid: Grid, device: torch.device) -> Extractor:
    """The extractor on the first stage's level, with the boxes it refines in.

    Raises ConfigError for boxes it cannot refine in, that miss the object's box, or whose cells would be too small.
    """
    stages = config.trainer.stages
    extractor = config.extractor.build(grid.at_level(stages[0].level), device)
    if not config.refine_box and config.trainer.cell_pixels is None:
        return extractor
    if not isinstance(extractor, RefiningExtractor):
        option = "--refine-box" if config.refine_box else "--trainer.cell-pixels"
        name = name_of(config.extractor)
        raise ConfigError(f"{option}: extractor {name!r} has cells of one size only; choose another")
    boxes = refine_boxes(config, box)
    try:
        wanted_levels(grid.at_level(config.trainer.finest_level), boxes)
    except ValueError as error:
        raise ConfigError(f"--refine-box-levels {config.refine_box_levels} is too many here: {error}") from error
    extractor.cells.set_boxes(boxes)
    if config.repair is not None:
        extractor.cells.hold_outside([each.box for each in boxes])
    return extractor


def take_images(trainer: BiLevelTrainer, config: TrainerConfig, images: Sequence[TrainingImage]) -> None:
    """A stage's images: terms compare them, and the extractor uses larger cells where they would not show smaller."""
    trainer.take_images(images)
    extractor = trainer.extractor
    if config.cell_pixels is not None and isinstance(extractor, RefiningExtractor):
        worth = level_map(extractor.grid, [image.camera for image in images], config.cell_pixels)
        extractor.cells.set_worth(LevelMap(levels=worth.levels.to(images[0].premultiplied.device)))


def refine_boxes(config: SculptingConfig, box: Box) -> list[RefineBox]:
    """The boxes of ``--refine-box`` in the object frame. Raises ConfigError for one that misses the object's box."""
    return [
        RefineBox(box=object_box("--refine-box", given[:3], given[3:], box), levels=config.refine_box_levels)
        for given in config.refine_box
    ]


def refine_in(parts: Parts, boxes: Sequence[RefineBox], finest: int) -> Parts:
    """Have the extractor refine in these boxes (object frame) and nowhere else, and the field follow.

    ``finest`` is the level of the finest stage. Raises ValueError if the extractor has cells of one size only, or if
    the smallest cells would have no coordinates.
    """
    extractor = parts.trainer.extractor
    if not isinstance(extractor, RefiningExtractor):
        raise ValueError("this extractor has cells of one size only")
    wanted_levels(parts.grid.at_level(finest), boxes)
    extractor.cells.set_boxes(boxes)
    refined = replace(parts, refinement=1 << max((box.levels for box in boxes), default=0))
    parts.trainer.field.set_detail(refined.detail)
    fit_seeds(refined)
    return refined


def set_level(parts: Parts, level: int) -> None:
    """Have extractor and field work on another level of the grid."""
    trainer, grid, old = parts.trainer, parts.grid.at_level(level), parts.trainer.extractor.grid
    if grid == old:
        return
    trainer.extractor.set_grid(grid)
    trainer.field.set_detail(parts.detail)
    if trainer.seeds is not None:
        # The surface's cells on the old level hold those on the new one, and the extraction follows it from there.
        trainer.seeds = cells_at_level(trainer.seeds, grid.level - old.level)


def find_seeds(parts: Parts) -> None:
    """Have the trainer start from all cells that the field's surface passes through."""
    field, grid = parts.trainer.field, parts.trainer.extractor.grid
    parts.trainer.seeds = discover(field, grid, coarse_level=0, lipschitz=_LIPSCHITZ, device=parts.device)


def fit_seeds(parts: Parts) -> None:
    """Without boxes no seed may be finer than the grid, though those of a state from before may be."""
    if parts.refinement == 1 and parts.trainer.seeds is not None:
        parts.trainer.seeds = coarsened(parts.trainer.seeds, parts.trainer.extractor.grid.level)


def build_objectives(config: SculptingConfig) -> Objectives:
    """Sort the configured terms by what they look at.

    The inner loop needs a term to learn colours from, a silhouette stage one that looks at masks: else ConfigError.
    """
    images: list[Weighted[ImageLoss]] = []
    geometry: list[Weighted[GeometryLoss]] = []
    views: list[Weighted[ViewsLoss]] = []
    for loss in config.losses:
        term, name = loss.build(), name_of(loss)
        if isinstance(term, ImageLoss):
            images.append(Weighted(name=name, weight=loss.weight, term=term))
        elif isinstance(term, ViewsLoss):
            views.append(Weighted(name=name, weight=loss.weight, term=term))
        else:
            geometry.append(Weighted(name=name, weight=loss.weight, term=term))
    colours = [objective for objective in images if objective.term.inner]
    silhouettes = [objective for objective in images if objective.term.outline]
    if not colours:
        raise ConfigError(f"--losses names no term that Gaussians learn colours from; add {PHOTOMETRIC}")
    if not silhouettes and any(stage.silhouette_only for stage in config.trainer.stages):
        raise ConfigError(f"the method has a silhouette stage but no {SILHOUETTE} loss; add it to --losses")
    return Objectives(
        inner=colours[0],
        images=images,
        silhouettes=silhouettes,
        geometry=geometry,
        views=views,
        constraints=[Weighted(name=name_of(c), weight=c.weight, term=c.build()) for c in config.constraints],
    )
