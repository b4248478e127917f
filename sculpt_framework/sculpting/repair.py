"""Local repair: a finished run is continued in boxes, and outside them its surface stays as it is.

The state the result was made of becomes the first state of a new run, which may only change what lies in the boxes
(``geometry.octree_hold``).
"""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from sculpt_framework.engine.checkpoint import Progress, Saved, read_checkpoint, with_best
from sculpt_framework.engine.run import CHECKPOINTS, read_config, told_in
from sculpt_framework.engine.session import Session
from sculpt_framework.engine.steering import Steering
from sculpt_framework.errors import CheckpointError, ConfigError
from sculpt_framework.evaluation.extracted import world_mesh
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.extractors import RefiningExtractor
from sculpt_framework.sculpting.assembly import refine_boxes
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.sculpting.method import Sculpting
from sculpt_framework.sculpting.state import capture, undisturbed
from sculpt_framework.types import Scene

_log = logging.getLogger("sculpt")


def start_of_repair(config: SculptingConfig, repaired: Path, scene: Scene) -> Saved:
    """What the repair of the finished run in ``repaired`` starts from: as a checkpoint of the new run, after no step.

    Raises ConfigError for boxes it cannot refine in, CheckpointError where there is no surface to hold. Says so where
    this machine does not reproduce the run's mesh.
    """
    boxes = refine_boxes(config, scene.box)
    saved = read_checkpoint(repaired / CHECKPOINTS)
    before = replace(read_config(repaired), device=config.device, max_time=None)
    session = Session(scene, before, saved=saved)
    method = session.reconstructor
    if not isinstance(method, Sculpting):
        raise CheckpointError(f"{repaired} is a run of {before.method!r}, which cannot be repaired in boxes")
    Steering(session, folder=repaired).take_up(told_in(repaired), session.step)
    psnr, trainer = session.at_result(), method.trainer
    if not isinstance(trainer.extractor, RefiningExtractor):
        raise ConfigError(
            "--refine-box: the run's extractor has cells of one size only; it cannot be repaired in boxes"
        )
    assert trainer.seeds is not None, "a finished run has a surface"  # noqa: S101
    with torch.no_grad(), undisturbed(trainer):
        mesh, _ = world_mesh(trainer.extract().surface.detach(), scene.box)
    surface = trainer.extractor.surface_to_hold(trainer.signed_distance, trainer.seeds)
    trainer.extractor.cells.hold_outside([each.box for each in boxes], surface)
    state = capture(trainer, 0, torch.Generator().manual_seed(config.seed))
    moved = _moved(repaired / "mesh.ply", mesh.vertices)
    if moved > 0:
        _log.warning(
            "this machine does not reproduce %s to the last bit: vertices outside the boxes are up to %.2g from there",
            repaired / "mesh.ply",
            moved,
        )
    progress = Progress(
        outer=0, progress=0.0, trained_seconds=0.0, best_psnr=psnr, rate_scale=1.0, recoveries=0, milestones=[]
    )
    return with_best(state, None if psnr is None else state), progress


def _moved(path: Path, vertices: np.ndarray) -> float:
    """Largest distance of vertices, which the file has as 32-bit floats, from where the file has them.

    Infinite where there are more or fewer of them.
    """
    saved, found = load_mesh(path).vertices, vertices.astype(np.float32).astype(np.float64)
    if saved.shape != found.shape:
        return float("inf")
    return float(np.linalg.norm(saved - found, axis=1).max(initial=0.0))
