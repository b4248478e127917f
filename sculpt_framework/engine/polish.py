"""Colours on the final surface, for as long as they gain something."""

import time
from collections.abc import Sequence
from typing import Any

import torch

from sculpt_framework.config import TrainerConfig
from sculpt_framework.engine.images import TrainingImage
from sculpt_framework.engine.reconstruction import object_gaussians
from sculpt_framework.engine.trainer import BiLevelTrainer
from sculpt_framework.evaluation.images import psnr
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Surface

CHUNK = 10
"""Steps between two looks at the clock and at what they have gained."""
_JUDGES = 2
"""Held-out views that judge: each costs about as much as a step."""
_RATE_AT_MOST = 0.3
"""Of the rates that a run begins with: higher ones would unsettle colours that are nearly right."""
_PATIENCE = 2
"""Chunks in a row that gain too little before it ends: one may be unlucky in its views."""


def polish(
    trainer: BiLevelTrainer,
    rasterizer: Rasterizer,
    surface: Surface,
    images: Sequence[TrainingImage],
    judges: Sequence[TrainingImage],
    config: TrainerConfig,
    deadline: float | None,
) -> dict[str, Any] | None:
    """Inner steps on ``surface``: as many as the config says, fewer if they stop to gain or the deadline comes.

    They go on at the rates that the run has ended with. Of colours that are watched the best are kept.

    ``deadline`` is a ``time.monotonic()`` instant. Returns the data of a decision if it ended for want of gain.
    """
    watching = config.polish_gain_db > 0 and len(judges) > 0
    judges, idle, first = judges[:_JUDGES], 0, trainer.processes.first
    learning, rate = trainer.scene.learning, min(_RATE_AT_MOST, config.final_rate)

    def score_now() -> float:
        return first(lambda: _score(trainer, rasterizer, surface, judges, config.low_pass_px2))

    score = best = score_now() if watching else 0.0
    kept = [tensor.detach().clone() for tensor in learning] if watching else []
    told = None
    for done in range(CHUNK, config.polish_steps + CHUNK, CHUNK):
        if deadline is not None and first(lambda: time.monotonic() >= deadline):
            break
        trainer.inner_loop(surface, images, CHUNK, rate_factor=rate)
        if not watching:
            continue
        score = score_now()
        idle = 0 if score > best + config.polish_gain_db else idle + 1
        if idle == _PATIENCE and done < config.polish_steps:
            left = config.polish_steps - done
            told = {"item": "polish", "value": f"ended after {done} steps", "spared": left, "gain_db": score - best}
            break
        if score > best:
            best, kept = score, [tensor.detach().clone() for tensor in learning]
    if score < best:
        with torch.no_grad():
            for tensor, value in zip(learning, kept, strict=True):
                tensor.copy_(value)
    return told


@torch.no_grad()
def _score(
    trainer: BiLevelTrainer,
    rasterizer: Rasterizer,
    surface: Surface,
    judges: Sequence[TrainingImage],
    low_pass_px2: float,
) -> float:
    """Mean psnr on the judges, in dB, on white."""
    gaussians, total = object_gaussians(trainer.scene, surface), 0.0
    for image in judges:
        white = torch.ones(3).to(image.premultiplied)
        rendering = rasterizer.render(gaussians, image.camera, white, low_pass_px2=low_pass_px2)
        total += psnr(rendering.rgb, image.over(white).rgb)
    return total / len(judges)
