"""A start that knows nothing takes its shape from silhouettes alone, before colours can tell anything (paper, 3.3)."""

import math
import time
from collections.abc import Sequence
from typing import Any

from sculpt_framework.errors import TrainingFailed
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.losses import TrainingImage
from sculpt_framework.posed_images.training_images import pixel_footprint, prepare_images
from sculpt_framework.sculpting.assembly import Parts, find_seeds, set_level
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.stop_rule import FEWEST, StopRule
from sculpt_framework.types import Box, View

STEPS = 150
"""On each level, at most."""
_VIEWS = 4
_LEAST_LOSS = 1e-12
"""What a loss of 0 counts as."""
_LAST_RATE = 0.1
"""Of the surface's rate that a level begins with."""
_PASS = 10
"""Steps whose mean loss is one score: single losses differ by their views."""
RULE = StopRule(least_gain=0.02, latest=FEWEST)
"""A level ends once its loss falls by less than this share."""


def shape_by_silhouettes(
    parts: Parts, config: SculptingConfig, views: Sequence[View], box: Box, end: float | None
) -> list[dict[str, Any]]:
    """Fit the field's surface to the masks, on all levels coarser than the first stage's; views in world frame.

    ``end`` is the ``time.monotonic()`` instant by which it has to be done; None where there is no time limit.

    Only where the initializer asks for it, there are masks and a term that looks at them, and the method does not begin
    with such a stage itself. Returns the data of the decision, if it was done. Optimisers begin anew after it. Raises
    TrainingFailed if the surface is lost on the way.
    """
    trainer, first = parts.trainer, config.trainer.stages[0]
    if not config.initializer.build().silhouette_first or first.silhouette_only:
        return []
    if not trainer.objectives.silhouettes or all(view.alpha is None for view in views):
        return []
    taken, loss = 0, math.nan
    try:
        for level in range(max(1, first.level)):
            scale = first.image_scale / 2 ** (first.level - level)
            stage = StageConfig(
                share=1.0, level=level, image_scale=scale, inner_steps=0, outer_views=_VIEWS, silhouette_only=True
            )
            set_level(parts, level)
            find_seeds(parts)
            images = prepare_images(views, box, scale, parts.device)
            trainer.scene.blur = math.sqrt(config.trainer.low_pass_px2) * pixel_footprint(images)
            losses = _fit(trainer, images, stage, end)
            taken, loss = taken + len(losses), (losses or [loss])[-1]
    except (EmptySurfaceError, FloatingPointError) as error:
        hint = "start with --initializer visual-hull"
        raise TrainingFailed(f"silhouettes cannot shape the start ({error}); {hint}") from error
    trainer.seeds, trainer.extraction = None, None
    trainer.begin_stage()
    trainer.optimizer.load_state({})
    trainer.scene.forget()
    return [{"item": "silhouettes first", "value": f"{taken} steps", "loss": loss}]


def _fit(
    trainer: BiLevelTrainer, images: Sequence[TrainingImage], stage: StageConfig, end: float | None
) -> list[float]:
    """Silhouette steps until they gain no more, or their time is over; the loss of each."""
    losses: list[float] = []
    watched: list[tuple[float, float]] = []
    for step in range(STEPS):
        if trainer.processes.first(lambda: end is not None and time.monotonic() >= end):
            break
        settled = trainer.settle(images, stage, 1.0)
        report = trainer.update(settled, images, stage, _LAST_RATE ** (step / STEPS))
        losses.append(sum(report.terms[each.name] for each in trainer.objectives.silhouettes))
        if len(losses) % _PASS == 0:
            mean = sum(losses[-_PASS:]) / _PASS
            watched.append((float(step), -math.log(max(mean, _LEAST_LOSS))))
            if RULE.stops(watched):
                break
    return losses
