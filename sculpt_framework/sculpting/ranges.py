"""Ranges of the bi-level method's numbers; the message names the option."""

from sculpt_framework.errors import ConfigError
from sculpt_framework.registry import name_of
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig, TrainerConfig
from sculpt_framework.validation import require


def check(config: SculptingConfig) -> None:
    """Raise ConfigError for the first value that no run can use."""
    for low, high in ((box[:3], box[3:]) for box in config.refine_box):
        given = " ".join(f"{number:g}" for number in (*low, *high))
        require(all(a < b for a, b in zip(low, high, strict=True)), "refine-box", given, "X0 < X1, Y0 < Y1, Z0 < Z1")
    require(1 <= config.refine_box_levels <= 6, "refine-box-levels", config.refine_box_levels, "1 to 6")
    _check_trainer(config.trainer)
    for slot, terms in (("losses", config.losses), ("constraints", config.constraints)):
        for term in terms:
            require(term.weight >= 0, f"{slot}.{name_of(term)}.weight", term.weight, "0 or more")


def _check_trainer(trainer: TrainerConfig) -> None:
    require(trainer.base_cells >= 2, "trainer.base-cells", trainer.base_cells, "2 or more")
    if trainer.cell_pixels is not None:
        require(0 < trainer.cell_pixels <= 1000, "trainer.cell-pixels", trainer.cell_pixels, "above 0, at most 1000")
    require(0 < trainer.final_rate <= 1, "trainer.final-rate", trainer.final_rate, "above 0, at most 1")
    require(trainer.bind_every >= 1, "trainer.bind-every", trainer.bind_every, "1 or more")
    require(trainer.sh_degree_every >= 1, "trainer.sh-degree-every", trainer.sh_degree_every, "1 or more")
    require(trainer.low_pass_px2 >= 0, "trainer.low-pass-px2", trainer.low_pass_px2, "0 or more")
    require(trainer.fit_steps >= 0, "trainer.fit-steps", trainer.fit_steps, "0 or more")
    require(trainer.warm_up_steps >= 0, "trainer.warm-up-steps", trainer.warm_up_steps, "0 or more")
    require(trainer.surface_steps >= 0, "trainer.surface-steps", trainer.surface_steps, "0 or more")
    require(trainer.ramp_steps >= 1, "trainer.ramp-steps", trainer.ramp_steps, "1 or more")
    require(trainer.trust_cells >= 0, "trainer.trust-cells", trainer.trust_cells, "0 or more")
    require(trainer.polish_steps >= 0, "trainer.polish-steps", trainer.polish_steps, "0 or more")
    require(trainer.polish_gain_db >= 0, "trainer.polish-gain-db", trainer.polish_gain_db, "decibels, 0 or more")
    batch = trainer.inner_batch
    require(batch is None or batch >= 1, "trainer.inner-batch", batch, "1 or more")
    require(trainer.rest_after >= 0, "trainer.rest-after", trainer.rest_after, "0 or more")
    if not trainer.stages:
        raise ConfigError("the method has no stages; a run needs at least one.")
    for index, stage in enumerate(trainer.stages):
        _check_stage(stage, f"trainer.stages.{index}")


def _check_stage(stage: StageConfig, prefix: str) -> None:
    require(stage.share > 0, f"{prefix}.share", stage.share, "above 0")
    require(0 <= stage.level <= 10, f"{prefix}.level", stage.level, "0 to 10")
    require(0 < stage.image_scale <= 1, f"{prefix}.image-scale", stage.image_scale, "above 0, at most 1")
    require(stage.inner_steps >= 0, f"{prefix}.inner-steps", stage.inner_steps, "0 or more")
    require(stage.outer_views >= 1, f"{prefix}.outer-views", stage.outer_views, "1 or more")
