"""Ranges of a config's numbers, checked before anything is built; the message names the option."""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from sculpt_framework.config import ComponentConfig, MethodConfig, StageConfig, TrainerConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.registry import SLOTS, name_of


def check(config: MethodConfig) -> None:
    """Raise ConfigError for the first value that no run can use."""
    for option, value in _numbers(config, ""):
        _require(math.isfinite(value), option, value, "a finite number")
    if config.max_time is not None:
        _require(config.max_time > 0, "max-time", config.max_time, "seconds above 0")
    if config.threads is not None:
        _require(config.threads >= 1, "threads", config.threads, "1 or more")
    _require(0 <= config.seed < 2**63, "seed", config.seed, "0 or more, below 2^63")
    for low, high in ((box[:3], box[3:]) for box in config.refine_box):
        given = " ".join(f"{number:g}" for number in (*low, *high))
        _require(all(a < b for a, b in zip(low, high, strict=True)), "refine-box", given, "X0 < X1, Y0 < Y1, Z0 < Z1")
    _require(1 <= config.refine_box_levels <= 6, "refine-box-levels", config.refine_box_levels, "1 to 6")
    _check_trainer(config.trainer)
    for slot in (slot for slot in SLOTS.values() if slot.many):
        names = [name_of(component) for component in getattr(config, slot.name)]
        _require(len(set(names)) == len(names), slot.name, " ".join(names), "each name once")
    for loss in config.losses:
        _require(loss.weight >= 0, f"losses.{name_of(loss)}.weight", loss.weight, "0 or more")
    for constraint in config.constraints:
        option = f"constraints.{name_of(constraint)}.weight"
        _require(constraint.weight >= 0, option, constraint.weight, "0 or more")


def _check_trainer(trainer: TrainerConfig) -> None:
    _require(trainer.outer_steps >= 1, "trainer.outer-steps", trainer.outer_steps, "1 or more")
    _require(trainer.base_cells >= 2, "trainer.base-cells", trainer.base_cells, "2 or more")
    if trainer.cell_pixels is not None:
        _require(0 < trainer.cell_pixels <= 1000, "trainer.cell-pixels", trainer.cell_pixels, "above 0, at most 1000")
    _require(0 < trainer.final_rate <= 1, "trainer.final-rate", trainer.final_rate, "above 0, at most 1")
    _require(trainer.bind_every >= 1, "trainer.bind-every", trainer.bind_every, "1 or more")
    _require(trainer.sh_degree_every >= 1, "trainer.sh-degree-every", trainer.sh_degree_every, "1 or more")
    _require(trainer.low_pass_px2 >= 0, "trainer.low-pass-px2", trainer.low_pass_px2, "0 or more")
    _require(trainer.holdout_every >= 0, "trainer.holdout-every", trainer.holdout_every, "0 or more")
    _require(trainer.fit_steps >= 0, "trainer.fit-steps", trainer.fit_steps, "0 or more")
    _require(trainer.warm_up_steps >= 0, "trainer.warm-up-steps", trainer.warm_up_steps, "0 or more")
    _require(trainer.surface_steps >= 0, "trainer.surface-steps", trainer.surface_steps, "0 or more")
    _require(trainer.ramp_steps >= 1, "trainer.ramp-steps", trainer.ramp_steps, "1 or more")
    _require(trainer.trust_cells >= 0, "trainer.trust-cells", trainer.trust_cells, "0 or more")
    _require(trainer.polish_steps >= 0, "trainer.polish-steps", trainer.polish_steps, "0 or more")
    _require(trainer.polish_gain_db >= 0, "trainer.polish-gain-db", trainer.polish_gain_db, "decibels, 0 or more")
    _require(0 <= trainer.inner_gain < 1, "trainer.inner-gain", trainer.inner_gain, "0 or more, below 1")
    _require(trainer.still_cells >= 0, "trainer.still-cells", trainer.still_cells, "0 or more")
    batch = trainer.inner_batch
    _require(batch is None or batch >= 1, "trainer.inner-batch", batch, "1 or more")
    _require(trainer.rest_after >= 0, "trainer.rest-after", trainer.rest_after, "0 or more")
    _require(
        trainer.checkpoint_seconds > 0, "trainer.checkpoint-seconds", trainer.checkpoint_seconds, "seconds above 0"
    )
    if not trainer.stages:
        raise ConfigError("the method has no stages; a run needs at least one.")
    for index, stage in enumerate(trainer.stages):
        _check_stage(stage, f"trainer.stages.{index}")


def _check_stage(stage: StageConfig, prefix: str) -> None:
    _require(stage.share > 0, f"{prefix}.share", stage.share, "above 0")
    _require(0 <= stage.level <= 10, f"{prefix}.level", stage.level, "0 to 10")
    _require(0 < stage.image_scale <= 1, f"{prefix}.image-scale", stage.image_scale, "above 0, at most 1")
    _require(stage.inner_steps >= 0, f"{prefix}.inner-steps", stage.inner_steps, "0 or more")
    _require(stage.outer_views >= 1, f"{prefix}.outer-views", stage.outer_views, "1 or more")


def _require(holds: bool, option: str, value: object, expected: str) -> None:
    if not holds:
        raise ConfigError(f"--{option} is {value}; expected {expected}.")


def _numbers(value: object, option: str) -> Iterator[tuple[str, float]]:
    """Every floating-point number in a config, with its option."""
    prefix = f"{option}." if option else ""
    if isinstance(value, float):
        yield option, value
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from _numbers(item, f"{prefix}{name_of(item) if isinstance(item, ComponentConfig) else index}")
    elif is_dataclass(value):
        for each in fields(value):
            yield from _numbers(getattr(value, each.name), f"{prefix}{each.name.replace('_', '-')}")
