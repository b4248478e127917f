"""The surface in a checkpoint: all that a killed run may have left."""

from pathlib import Path

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.checkpoint import read_checkpoint
from sculpt_framework.engine.run import CHECKPOINTS
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import CheckpointError
from sculpt_framework.viewing.frames import Frame, frame_of


def frame_of_checkpoint(folder: Path, config: MethodConfig) -> Frame:
    """The surface that the run would go on with.

    Raises CheckpointError if there is no checkpoint or it does not fit the config, DataError without the scene.
    """
    saved = read_checkpoint(folder / CHECKPOINTS)
    session = Session(config.dataset.build(config.data).load(), config, saved=saved)
    session.show_saved()
    snapshot = session.reconstructor.snapshot()
    if snapshot is None:
        raise CheckpointError(f"the checkpoint in {folder} holds no surface")
    return frame_of(snapshot, outer=saved[1].outer, t_train=saved[1].trained_seconds)
