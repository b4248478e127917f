"""The surface in a checkpoint: all that a killed run may have left."""

from pathlib import Path

import torch

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.checkpoint import read_checkpoint
from sculpt_framework.engine.run import CHECKPOINTS
from sculpt_framework.errors import CheckpointError
from sculpt_framework.sculpting.assembly import build_parts
from sculpt_framework.sculpting.snapshot import take_snapshot
from sculpt_framework.sculpting.state import restore, split_best
from sculpt_framework.viewing.frames import Frame, frame_of


def frame_of_checkpoint(folder: Path, config: MethodConfig) -> Frame:
    """Extract the surface that the run would go on with.

    Raises CheckpointError if there is no checkpoint or it does not fit the config, DataError without the scene.
    """
    state, progress = read_checkpoint(folder / CHECKPOINTS)
    scene = config.dataset.build(config.data).load()
    generator = torch.Generator()
    parts = build_parts(config, scene.box, generator)
    trainer, (latest, _) = parts.trainer, split_best(state)
    level = config.trainer.stages[int(latest["stage"])].level
    trainer.extractor.set_grid(parts.grid.at_level(level))
    trainer.field.set_detail(parts.detail)
    try:
        restore(trainer, generator, latest)
    except (KeyError, RuntimeError) as error:
        raise CheckpointError(f"the checkpoint does not fit the run's config.json ({error})") from error
    with torch.no_grad():
        trainer.scene.follow(trainer.extract().surface)
    snapshot = take_snapshot(trainer, scene.box)
    assert snapshot is not None, "a surface was extracted just now"  # noqa: S101
    return frame_of(snapshot, outer=progress.outer, t_train=progress.trained_seconds)
