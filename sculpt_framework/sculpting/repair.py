"""Local repair: a finished run is gone on with in boxes, and outside them its surface stays as it is.

The state the result was made of becomes the first state of a new run, which may only change what lies in the boxes
(``geometry.octree_hold``).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from sculpt_framework.commands import Recorded
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.pipeline import Pipeline
from sculpt_framework.engine.steering import Steering
from sculpt_framework.errors import ConfigError
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.extractors import RefiningExtractor
from sculpt_framework.sculpting.assembly import refine_boxes
from sculpt_framework.sculpting.reconstruction import world_mesh
from sculpt_framework.sculpting.state import Progress, capture, undisturbed, with_best
from sculpt_framework.types import Scene


@dataclass(frozen=True, kw_only=True, eq=False)
class RepairStart:
    """What a repair starts from: as a checkpoint of the new run, after no step."""

    state: dict[str, Tensor]
    progress: Progress
    moved: float
    """How far the held surface is from the finished run's mesh at most, world units; 0: the same to the bit."""


def repair_start(
    config: MethodConfig,
    before: MethodConfig,
    scene: Scene,
    saved: tuple[dict[str, Tensor], Progress],
    told: list[Recorded],
) -> RepairStart:
    """Hold the surface of the run that finished with ``saved``.

    ``before`` is that run's config, ``told`` what it was told in its viewer; ``config`` is the new run's. Raises
    ConfigError for boxes it cannot refine in, and where there is no surface to hold.
    """
    assert config.repair is not None, "a repair names the run it repairs"  # noqa: S101
    boxes = refine_boxes(config, scene.box)
    pipeline = Pipeline(replace(before, device=config.device, max_time=None), scene=scene)
    Steering(pipeline, emit=lambda event: None, folder=config.repair).take_up(told, saved[1].outer)
    trainer, psnr = pipeline.at_result(saved)
    if not isinstance(trainer.extractor, RefiningExtractor):
        raise ConfigError(
            "--refine-box: the run's extractor has cells of one size only; it cannot be repaired in boxes"
        )
    assert trainer.seeds is not None, "a finished run has a surface"  # noqa: S101
    with torch.no_grad(), undisturbed(trainer):
        mesh, _ = world_mesh(trainer.extract().surface.detach(), scene.box)
    trainer.extractor.hold_outside(boxes, (trainer.signed_distance, trainer.seeds))
    state = capture(trainer, 0, torch.Generator().manual_seed(config.seed))
    return RepairStart(
        state=with_best(state, None if psnr is None else state),
        progress=Progress(
            outer=0, progress=0.0, trained_seconds=0.0, best_psnr=psnr, rate_scale=1.0, recoveries=0, milestones=[]
        ),
        moved=_moved(config.repair / "mesh.ply", mesh.vertices),
    )


def _moved(path: Path, vertices: np.ndarray) -> float:
    """Largest distance of vertices, which the file has as 32-bit floats, from where the file has them.

    Infinite where there are more or fewer of them.
    """
    saved, found = load_mesh(path).vertices, vertices.astype(np.float32).astype(np.float64)
    if saved.shape != found.shape:
        return float("inf")
    return float(np.linalg.norm(saved - found, axis=1).max(initial=0.0))
