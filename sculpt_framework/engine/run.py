"""A run with a directory: what ``sculpt-train`` does once it knows the config."""

import json
import logging
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor

from sculpt_framework.commands import Recorded, read_recorded
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.checkpoint import read_checkpoint, write_checkpoint
from sculpt_framework.engine.images import prepare_image
from sculpt_framework.engine.measuring import image_measures
from sculpt_framework.engine.output import prepare_output
from sculpt_framework.engine.parallel import Processes, gather, shared_commands, with_batch
from sculpt_framework.engine.pipeline import Pipeline
from sculpt_framework.engine.steering import Steering
from sculpt_framework.engine.view_pictures import RESULT, image_picture, view_pictures
from sculpt_framework.errors import CheckpointError, SculptError, TrainingFailed
from sculpt_framework.evaluation.pictures import Picture
from sculpt_framework.evaluation.report import write_report
from sculpt_framework.events import Event
from sculpt_framework.export.atomic import cannot_write, remove_partial_files, write_atomically
from sculpt_framework.export.gaussian_files import read_gaussians_ply, write_gaussians_ply
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_ply
from sculpt_framework.observers import Observer, SteeringObserver
from sculpt_framework.plan.decision import ScenePlan, write_plan
from sculpt_framework.sculpting.assembly import pick_device
from sculpt_framework.sculpting.reconstruction import Reconstruction
from sculpt_framework.sculpting.repair import repair_start
from sculpt_framework.sculpting.state import Progress
from sculpt_framework.serialization import config_from_json, config_to_json
from sculpt_framework.types import Gaussians, Scene

CONFIG_NAME = "config.json"
CHECKPOINTS = "checkpoints"
EVENTS_NAME = "events.jsonl"
MESH_NAME = "mesh.ply"
REPORT_NAME = "report.html"
_log = logging.getLogger("sculpt")


def run(config: MethodConfig, *, resume: Path | None, started: float) -> None:
    """Train and leave the results in the run directory.

    ``started`` is the ``time.monotonic()`` instant that ``--max-time`` counts from. With ``resume`` that directory's
    run goes on from its checkpoint, under the config given, which the caller has read from there; a run that has
    finished is left as it is.

    Raises SculptError for whatever the user can mend, and TrainingFailed where training had to end early, after saving
    the best there was by then.
    """
    if config.threads is not None:
        torch.set_num_threads(config.threads)
    processes = gather(os.environ, pick_device(config.device))
    if resume is not None:
        processes.first(lambda: remove_partial_files(resume))
        if run_status(resume) == "finished":
            processes.first(lambda: _tell_finished(resume))
            processes.close()
            return
    saved = None if resume is None else read_checkpoint(resume / CHECKPOINTS)
    if resume is None and config.repair is not None:
        require_finished(config.repair)
    for observer in config.observers:
        observer.check()
    scene = processes.in_turn(lambda: config.dataset.build(config.data).load())
    if resume is None and config.repair is not None:
        saved = _start_repair(config, config.repair, scene)
    plan = None
    if saved is None:
        config, plan = _plan(config, scene, processes)
    config = with_batch(config, processes)
    # The first process makes the folder, in which another may find what the first has written.
    folder = Path(processes.first(lambda: str(_run_folder(config, resume, plan))))
    observers = [observer.build(folder) for observer in config.observers] if processes.leads else []
    try:
        with stop_on_interrupt() as stop_requested:
            if plan is not None:
                told = Event(t_train=0.0, t_wall=time.monotonic() - started, outer=0, event="plan", data=plan.values())
                for observer in observers:
                    observer.notify(told)
            _train(config, scene, folder, observers, saved, stop_requested, started, processes)
    finally:
        for observer in observers:
            observer.close()


def _tell_finished(folder: Path) -> None:
    """Say where the results are; a run that was killed before its report was written gets that now."""
    if not (folder / REPORT_NAME).is_file():
        try:
            write_report(folder, load_finished(folder).pictures())
        except SculptError as error:
            _log.warning("no report: %s", error)
    sys.stdout.write(f"{folder} has finished already; its mesh is {folder / MESH_NAME}\n")


def _run_folder(config: MethodConfig, resume: Path | None, plan: ScenePlan | None) -> Path:
    """The run directory, ready to be written to."""
    if resume is None:
        folder = prepare_output(config)
        write_atomically(folder / CONFIG_NAME, config_to_json(config).encode())
        if plan is not None:
            write_plan(plan, folder)
    else:
        folder = resume
    try:
        (folder / CHECKPOINTS).mkdir(exist_ok=True)
    except OSError as error:
        raise cannot_write(folder / CHECKPOINTS, error) from error
    return folder


def _train(
    config: MethodConfig,
    scene: Scene,
    folder: Path,
    observers: Sequence[Observer],
    saved: tuple[Mapping[str, Tensor], Progress] | None,
    stop_requested: "StopFlag",
    started: float,
    processes: Processes,
) -> None:
    def emit(event: Event) -> None:
        for observer in observers:
            observer.notify(event)

    def save(state: Mapping[str, Tensor], progress: Progress) -> None:
        write_checkpoint(folder / CHECKPOINTS, state, progress)

    intervals = [o.snapshot_seconds for o in observers if o.snapshot_seconds is not None]
    replay = [] if config.replay is None else read_recorded(config.replay)
    pipeline = Pipeline(
        config,
        scene=scene,
        emit=emit,
        should_stop=lambda: steering(),
        save=save,
        started=started,
        processes=processes,
    )
    steering = Steering(
        pipeline,
        emit=emit,
        folder=folder,
        sources=shared_commands([o.take_commands for o in observers if isinstance(o, SteeringObserver)], processes),
        replay=replay,
        interrupted=lambda: processes.first(stop_requested),
        snapshot_seconds=min(intervals) if intervals else None,
    )
    # A repair starts from a state that it was told nothing on the way to.
    if saved is not None and saved[1].outer > 0:
        steering.take_up(_told(folder), saved[1].outer)
    result = pipeline.train(saved)
    processes.close()
    if not processes.leads:
        return
    files = write_results(folder, result)
    report = folder / REPORT_NAME
    pipeline.announce_end(result, {"run_dir": str(folder), **files, "report": str(report)})
    try:
        write_report(folder, pipeline.pictures())
    except SculptError as error:
        # The mesh is saved and measured: a page about it is not worth losing that.
        pipeline.warn(f"no report: {error}")
    if pipeline.failure is not None:
        raise TrainingFailed(f"{pipeline.failure}; the best mesh until then is {files['mesh']}")


def _plan(config: MethodConfig, scene: Scene, processes: Processes) -> tuple[MethodConfig, ScenePlan | None]:
    """What to train, after a look at the scene; without that, and what it needs, where nothing is to be decided.

    The first process has the plan, all have the config that follows from it.
    """
    if not config.plan.items:
        return config, None
    from sculpt_framework.plan.make import plan_scene

    made: list[ScenePlan | None] = []

    def decide() -> str:
        decided, plan = plan_scene(config, scene)
        made.append(plan)
        return config_to_json(decided)

    return config_from_json(processes.first(decide)), made[0] if made else None


def _start_repair(config: MethodConfig, repaired: Path, scene: Scene) -> tuple[Mapping[str, Tensor], Progress]:
    saved = read_checkpoint(repaired / CHECKPOINTS)
    start = repair_start(config, read_config(repaired), scene, saved, _told(repaired))
    if start.moved > 0:
        _log.warning(
            "this machine does not reproduce %s to the last bit: vertices outside the boxes are up to %.2g from there",
            repaired / MESH_NAME,
            start.moved,
        )
    return start.state, start.progress


def _told(folder: Path) -> list[Recorded]:
    """The commands that the run in ``folder`` obeyed; none where it had no recorder to note them."""
    events = folder / EVENTS_NAME
    return read_recorded(events) if events.is_file() else []


def require_finished(folder: Path) -> None:
    """Raise CheckpointError unless the run has finished: only its result can be repaired."""
    status = run_status(folder)
    if status != "finished":
        raise CheckpointError(
            f"--resume {folder} --refine-box repairs a finished run; this one is "
            f"{'unfinished' if status is None else status}. Go on with it first: --resume {folder}"
        )


def write_results(folder: Path, result: Reconstruction) -> dict[str, str]:
    """Write mesh and Gaussians; returns their paths by kind."""
    paths = {"mesh": folder / MESH_NAME, "glb": folder / "mesh.glb", "gaussians": folder / "gaussians.ply"}
    write_mesh_ply(paths["mesh"], result.vertices, result.faces, result.colors)
    write_mesh_glb(paths["glb"], result.vertices, result.faces, result.colors)
    write_gaussians_ply(paths["gaussians"], result.gaussians)
    return {kind: str(path) for kind, path in paths.items()} | {"curve": str(folder / "curve.csv")}


class StopFlag:
    """Set by the first Ctrl-C, or by SIGTERM; asked by the trainer before each step."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self) -> bool:
        return self.requested


@contextmanager
def stop_on_interrupt() -> Iterator[StopFlag]:
    """Ctrl-C once: stop and save. Twice: stop now. SIGTERM, as schedulers and torchrun send it: stop and save."""
    flag = StopFlag()

    def handle(number: int, frame: FrameType | None) -> None:
        if flag.requested and number == signal.SIGINT:
            raise KeyboardInterrupt
        flag.requested = True
        again = "press Ctrl-C again to stop at once" if number == signal.SIGINT else "asked to by SIGTERM"
        _log.warning("stopping after this step and saving; %s", again)

    try:
        previous = [(number, signal.signal(number, handle)) for number in (signal.SIGINT, signal.SIGTERM)]
    except ValueError:  # not in the main thread: whoever runs us decides about interrupts
        yield flag
        return
    try:
        yield flag
    finally:
        for number, handler in previous:
            signal.signal(number, handler)


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

    def pictures(self) -> dict[str, dict[str, Picture]]:
        """A test view, or a train view if there is none, beside the Gaussians; as a run shows itself in its report."""
        device = pick_device(self.config.device)
        view = (*self.scene.test, *self.scene.train)[0]
        image = prepare_image(view, self.scene.box, 1.0, device, crop=False)
        rasterizer, low_pass = self.config.rasterizer.build(device), self.config.trainer.low_pass_px2
        pictures = view_pictures(rasterizer, self.gaussians, image, low_pass, errors=None)
        return {RESULT: {**image_picture(image), **pictures}}


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
    """How a run ended: finished, stopped or failed; None if it has not, or if that cannot be read any more."""
    path = folder / "metrics.json"
    try:
        metrics: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return metrics.get("status")
    except (OSError, ValueError, AttributeError):
        return None
