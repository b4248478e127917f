"""From a config to the components it names."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.gaussian_scene import GaussianScene
from sculpt_framework.engine.trainer import BiLevelTrainer, Objectives, Weighted
from sculpt_framework.errors import ConfigError, DeviceError
from sculpt_framework.extractors import Extractor, RefiningExtractor
from sculpt_framework.geometry.grid import Grid, RefineBox, grid_over_box
from sculpt_framework.geometry.octree_policy import wanted_levels
from sculpt_framework.losses import GeometryLoss, ImageLoss
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.registry import name_of
from sculpt_framework.types import Box

PHOTOMETRIC, SILHOUETTE = "photometric", "silhouette"


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


def pick_device(wanted: str) -> torch.device:
    """Raises DeviceError if CUDA is asked for and absent."""
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise DeviceError("--device cuda was asked for, but torch sees no CUDA device here; use --device cpu or auto")
    return torch.device("cuda" if available and wanted != "cpu" else "cpu")


def build_parts(config: MethodConfig, box: Box, generator: torch.Generator) -> Parts:
    """Build every component. Parameters are drawn from torch's own generator, seeded here with the run's seed."""
    device = pick_device(config.device)
    trainer = config.trainer
    if not trainer.stages:
        raise ConfigError("the method has no stages; --trainer.stages needs at least one")
    torch.manual_seed(config.seed)
    grid = grid_over_box(box.half_sides, trainer.base_cells)
    field = config.field.build(device)
    rasterizer = config.rasterizer.build(device)
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
        ),
    )


def build_extractor(config: MethodConfig, box: Box, grid: Grid, device: torch.device) -> Extractor:
    """The extractor on the first stage's level, with the boxes it refines in.

    Raises ConfigError for boxes it cannot refine in, that miss the object's box, or whose cells would be too small.
    """
    stages = config.trainer.stages
    extractor = config.extractor.build(grid.at_level(stages[0].level), device)
    if not config.refine_box:
        return extractor
    if not isinstance(extractor, RefiningExtractor):
        name = name_of(config.extractor)
        raise ConfigError(f"--refine-box: extractor {name!r} has cells of one size only; choose another")
    boxes = []
    for given in config.refine_box:
        low, high = torch.tensor(given[:3]), torch.tensor(given[3:])
        if bool((low >= box.maximum).any() | (high <= box.minimum).any()):
            corners = [f"{number:.4g}" for number in (*box.minimum.tolist(), *box.maximum.tolist())]
            raise ConfigError(
                f"--refine-box {' '.join(f'{number:g}' for number in given)} lies outside the object's box, "
                f"which is {' '.join(corners)}"
            )
        x, y, z = box.to_object(torch.stack([low, high])).double().T.tolist()
        low_corner, high_corner = (x[0], y[0], z[0]), (x[1], y[1], z[1])
        boxes.append(RefineBox(minimum=low_corner, maximum=high_corner, levels=config.refine_box_levels))
    try:
        wanted_levels(grid.at_level(max(stage.level for stage in stages)), boxes)
    except ValueError as error:
        raise ConfigError(f"--refine-box-levels {config.refine_box_levels} is too many here: {error}") from error
    extractor.set_boxes(boxes)
    return extractor


def build_objectives(config: MethodConfig) -> Objectives:
    """Sort the configured terms by what they look at.

    The inner loop needs a photometric term and the outer one something that sees images: ConfigError otherwise.
    """
    images: list[Weighted[ImageLoss]] = []
    geometry: list[Weighted[GeometryLoss]] = []
    for loss in config.losses:
        term, name = loss.build(), name_of(loss)
        if isinstance(term, ImageLoss):
            images.append(Weighted(name=name, weight=loss.weight, term=term))
        else:
            geometry.append(Weighted(name=name, weight=loss.weight, term=term))
    colours = [objective.term for objective in images if objective.name != SILHOUETTE]
    silhouettes = [objective for objective in images if objective.name == SILHOUETTE]
    if not colours:
        raise ConfigError(f"--losses names no term that compares colours; add {PHOTOMETRIC}")
    if not silhouettes and any(stage.silhouette_only for stage in config.trainer.stages):
        raise ConfigError(f"the method has a silhouette stage but no {SILHOUETTE} loss; add it to --losses")
    return Objectives(
        photometric=colours[0],
        images=images,
        silhouettes=silhouettes,
        geometry=geometry,
        constraints=[Weighted(name=name_of(c), weight=c.weight, term=c.build()) for c in config.constraints],
    )


def split_views(count: int, every: int) -> tuple[Sequence[int], Sequence[int]]:
    """Indices to train on and to hold out: one of every ``every``, from the middle of each run of that length."""
    if every <= 1 or count < every:
        return range(count), ()
    held = set(range(every // 2, count, every))
    return [index for index in range(count) if index not in held], sorted(held)
