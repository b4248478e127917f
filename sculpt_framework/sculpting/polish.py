"""Colours on the final surface, for as long as they gain something."""

import time
from collections.abc import Sequence
from typing import Any

import torch

from sculpt_framework.losses import TrainingImage
from sculpt_framework.sculpting.config import TrainerConfig
from sculpt_framework.sculpting.reconstruction import object_gaussians
from sculpt_framework.sculpting.sh_pruning import Judge
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.stop_rule import FEWEST, StopRule
from sculpt_framework.types import Surface

CHUNK = 10
"""Steps between two looks at the clock and at what they have gained."""


def polish(
    trainer: BiLevelTrainer,
    surface: Surface,
    images: Sequence[TrainingImage],
    judge: Judge | None,
    config: TrainerConfig,
    deadline: float | None,
) -> list[dict[str, Any]]:
    """Inner steps on ``surface``: as many as the config says, fewer if they stop to gain or the deadline comes.

    Of colours that are watched the best are kept.

    ``deadline`` is a ``time.monotonic()`` instant. Returns the data of the decision, if it ended for want of gain.
    """
    judge, first = judge if config.polish_gain_db > 0 else None, trainer.processes.first
    rule = StopRule(least_gain=config.polish_gain_db, latest=FEWEST)
    learning, first_rate = trainer.scene.learning, config.polish_rate
    last = min(first_rate, config.final_rate)

    score = best = judge(object_gaussians(trainer.scene, surface)) if judge else 0.0
    watched = [(0.0, score)]
    kept = [tensor.detach().clone() for tensor in learning] if judge else []
    told, began = [], time.monotonic()
    for before in range(0, config.polish_steps, CHUNK):
        done = min(before + CHUNK, config.polish_steps)
        # Of the time there is, or of the steps: what ends first.
        if (timed := first(lambda: _passed(began, deadline))) >= 1.0:
            break
        passed = min(1.0, max(timed, done / config.polish_steps))
        trainer.inner_loop(surface, images, done - before, rate_factor=first_rate * (last / first_rate) ** passed)
        if judge is None:
            continue
        score = judge(object_gaussians(trainer.scene, surface))
        watched.append((float(done), score))
        if score > best:
            best, kept = score, [tensor.detach().clone() for tensor in learning]
        if rule.stops(watched) and done < config.polish_steps:
            left, gain = config.polish_steps - done, rule.gain(watched)
            told.append({"item": "polish", "value": f"ended after {done} steps", "spared": left, "gain_db": gain})
            break
    if score < best:
        with torch.no_grad():
            for tensor, value in zip(learning, kept, strict=True):
                tensor.copy_(value)
    return told


def _passed(began: float, deadline: float | None) -> float:
    """Share of the time until the deadline; 0 where there is none."""
    now = time.monotonic()
    return 0.0 if deadline is None else 1.0 if now >= deadline else (now - began) / (deadline - began)
