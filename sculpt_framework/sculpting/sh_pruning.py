"""Spherical-harmonics bands that held-out views do not see are given up."""

from collections.abc import Callable
from typing import Any

from sculpt_framework.appearances import bands
from sculpt_framework.binders import Binding
from sculpt_framework.sculpting.config import TrainerConfig
from sculpt_framework.sculpting.gaussian_scene import assemble
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.types import Gaussians

Judge = Callable[[Gaussians], float]
"""The psnr of Gaussians (object frame) on a few held-out views, in dB."""

_GAIN_DB = 0.02
"""What bands bring at least, to be worth their rows."""


def prune_bands(
    trainer: BiLevelTrainer, binding: Binding, judge: Judge | None, config: TrainerConfig, outer: int
) -> list[dict[str, Any]]:
    """Give up the bands without which held-out views are as good, once all have learned for a while.

    Looked at every ``rest_after`` outer steps, so that runs repeat. They are left out from the highest down, together:
    two that only correct each other are both idle. Returns the data of the decision, if one was made.
    """
    scene, every = trainer.scene, config.rest_after
    degree = highest = scene.appearance.sh_degree
    if every == 0 or outer % every > 0 or highest == 0 or judge is None:
        return []
    if trainer.inner_total < (highest + 1) * config.sh_degree_every:
        return []

    def quality(degree: int) -> float:
        sh = scene.harmonics(binding.means, degree=degree, learn=False)
        return judge(assemble(binding.detach(), sh))

    best = quality(highest)
    lost = 0.0
    while degree > 0 and (less := best - quality(degree - 1)) < _GAIN_DB:
        degree, lost = degree - 1, less
    if degree == highest:
        return []
    scene.lower_sh_degree(degree)
    numbers = 3 * (bands(highest) - bands(degree))
    # The values, their gradients and Adam's two moments, in single precision.
    megabytes = binding.opacities.numel() * numbers * 4 * 4 / 1e6
    decided = {"item": "sh-degree", "value": f"degree {degree}, not {highest}", "lost_db": lost}
    return [{**decided, "spared": numbers, "megabytes": megabytes}]
