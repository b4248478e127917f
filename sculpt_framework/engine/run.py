"""A run with a directory: what ``sculpt-train`` does once it knows the config."""

import json
import logging
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.assembly import pick_device
from sculpt_framework.engine.checkpoint import read_checkpoint, write_checkpoint
from sculpt_framework.engine.events import Event
from sculpt_framework.engine.images import prepare_image
from sculpt_framework.engine.measuring import image_measures
from sculpt_framework.engine.output import prepare_output
from sculpt_framework.engine.pipeline import Pipeline, Progress
from sculpt_framework.engine.reconstruction import Reconstruction
from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.gaussian_files import read_gaussians_ply, write_gaussians_ply
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_ply
from sculpt_framework.observers import Observer
from sculpt_framework.serialization import config_from_json, config_to_json
from sculpt_framework.types import Gaussians, Scene

CONFIG_NAME = "config.json"
CHECKPOINTS = "checkpoints"
_log = logging.getLogger("sculpt")


def run(config: MethodConfig, *, resume: Path | None, started: float) -> None:
    """Train and leave the results in the run directory.

    ``started`` is the ``time.monotonic()`` instant that ``--max-time`` counts from. With ``resume`` the config comes
    from that directory and ``config`` only says where. Raises SculptError for whatever the user can mend.
    """
    if config.threads is not None:
        torch.set_num_threads(config.threads)
    pick_device(config.device)
    scene = config.dataset.build(config.data).load()
    saved = None
    if resume is None:
        folder = prepare_output(config)
        write_atomically(folder / CONFIG_NAME, config_to_json(config).encode())
    else:
        folder = resume
        saved = read_checkpoint(folder / CHECKPOINTS)
    checkpoints = folder / CHECKPOINTS
    checkpoints.mkdir(exist_ok=True)
    observers = [observer.build(folder) for observer in config.observers]
    try:
        with stop_on_interrupt() as stop_requested:
            _train(config, scene, folder, observers, saved, stop_requested, started)
    finally:
        for observer in observers:
            observer.close()


def _train(
    config: MethodConfig,
    scene: Scene,
    folder: Path,
    observers: Sequence[Observer],
    saved: tuple[Mapping[str, Tensor], Progress] | None,
    stop_requested: "StopFlag",
    started: float,
) -> None:
    def emit(event: Event) -> None:
        for observer in observers:
            observer.notify(event)

    def save(state: Mapping[str, Tensor], progress: Progress) -> None:
        write_checkpoint(folder / CHECKPOINTS, state, progress)

    intervals = [o.snapshot_seconds for o in observers if o.snapshot_seconds is not None]
    pipeline = Pipeline(
        config,
        scene=scene,
        emit=emit,
        should_stop=stop_requested,
        save=save,
        snapshot_seconds=min(intervals) if intervals else None,
        started=started,
    )
    result = pipeline.train(saved)
    files = write_results(folder, result)
    pipeline.save_checkpoint()
    pipeline.announce_end({"run_dir": str(folder), **files})


def write_results(folder: Path, result: Reconstruction) -> dict[str, str]:
    """Write mesh and Gaussians; returns their paths by kind."""
    paths = {"mesh": folder / "mesh.ply", "glb": folder / "mesh.glb", "gaussians": folder / "gaussians.ply"}
    write_mesh_ply(paths["mesh"], result.vertices, result.faces, result.colors)
    write_mesh_glb(paths["glb"], result.vertices, result.faces, result.colors)
    write_gaussians_ply(paths["gaussians"], result.gaussians)
    return {kind: str(path) for kind, path in paths.items()} | {"curve": str(folder / "curve.csv")}


class StopFlag:
    """Set by the first Ctrl-C; asked by the trainer before each step."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self) -> bool:
        return self.requested


@contextmanager
def stop_on_interrupt() -> Iterator[StopFlag]:
    """Ctrl-C once: stop and save. Twice: stop now."""
    flag = StopFlag()

    def handle(number: int, frame: FrameType | None) -> None:
        if flag.requested:
            raise KeyboardInterrupt
        flag.requested = True
        _log.warning("stopping after this step and saving; press Ctrl-C again to stop at once")

    try:
        previous = signal.signal(signal.SIGINT, handle)
    except ValueError:  # not in the main thread: whoever runs us decides about interrupts
        yield flag
        return
    try:
        yield flag
    finally:
        signal.signal(signal.SIGINT, previous)


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedRun:
    """A run read back: what is needed to look at it from the test views."""

    config: MethodConfig
    scene: Scene
    gaussians: Gaussians
    """In the object frame of ``scene.box``."""

    def test_measures(self) -> dict[str, float | None]:
        """psnr (dB), ssim and iou, means over the test views, on white over whole images."""
        device = pick_device(self.config.device)
        images = [prepare_image(view, self.scene.box, 1.0, device, crop=False) for view in self.scene.test]
        rasterizer = self.config.rasterizer.build(device)
        return image_measures(rasterizer, self.gaussians, images, self.config.trainer.low_pass_px2)


def read_config(folder: Path) -> MethodConfig:
    """The config a run directory was made with. Raises CheckpointError if it is not a run directory."""
    path = folder / CONFIG_NAME
    if not path.is_file():
        raise CheckpointError(f"{folder} is not a run directory: it has no {CONFIG_NAME}")
    return config_from_json(path.read_text(encoding="utf-8"))


def load_finished(folder: Path) -> FinishedRun:
    """Read a run's Gaussians and its scene. Raises CheckpointError if the run has not left any."""
    config = read_config(folder)
    path = folder / "gaussians.ply"
    if not path.is_file():
        raise CheckpointError(f"{folder} has no gaussians.ply: the run has not finished; go on with --resume {folder}")
    scene = config.dataset.build(config.data).load()
    world = read_gaussians_ply(path)
    box = scene.box
    gaussians = replace(world, means=box.to_object(world.means.double()).float(), scales=world.scales / box.scale)
    return FinishedRun(config=config, scene=scene, gaussians=gaussians)


def run_status(folder: Path) -> str | None:
    """ "finished", "stopped" or None while a run has no metrics yet."""
    path = folder / "metrics.json"
    if not path.is_file():
        return None
    metrics: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return metrics.get("status")
