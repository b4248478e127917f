"""A run with a directory: what ``sculpt-train`` does once it knows the config."""

import json
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor

from sculpt_framework.commands import Recorded, read_recorded
from sculpt_framework.config import MethodConfig
from sculpt_framework.device import pick_device
from sculpt_framework.engine.checkpoint import Progress, read_checkpoint, write_checkpoint
from sculpt_framework.engine.output import CONFIG_NAME, MESH_NAME, prepare_output
from sculpt_framework.engine.planning import as_trained
from sculpt_framework.engine.session import Session
from sculpt_framework.engine.steering import Steering
from sculpt_framework.errors import CheckpointError, SculptError, TrainingFailed
from sculpt_framework.evaluation.album import RESULT, image_picture, view_pictures
from sculpt_framework.evaluation.evaluator import image_measures
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.evaluation.pictures import Picture
from sculpt_framework.evaluation.report import write_report
from sculpt_framework.events import Event
from sculpt_framework.export.atomic import make_folder, remove_partial_files, write_atomically
from sculpt_framework.folder_lock import only_one
from sculpt_framework.frame import WorldFrame, frame_of, write_frame
from sculpt_framework.observers import Observer, SteeringObserver
from sculpt_framework.parallel.processes import ProcessLost, gather, shared_commands
from sculpt_framework.plan.decision import write_plan
from sculpt_framework.serialization import config_from_json, config_to_json
from sculpt_framework.types import Camera, Rendering, Scene

CHECKPOINTS = "checkpoints"
EVENTS_NAME = "events.jsonl"
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
    # Whatever ends the run, the folder is then free for another.
    with ExitStack() as held:
        _run(config, resume, started, held)


def _run(config: MethodConfig, resume: Path | None, started: float, held: ExitStack) -> None:
    processes = gather(os.environ, pick_device(config.device))
    if resume is not None:
        if run_status(resume) == "finished":
            processes.first(lambda: _tell_finished(resume))
            processes.close()
            return
        processes.first(lambda: _take_up(resume, held))
    saved = None if resume is None else read_checkpoint(resume / CHECKPOINTS)
    replay = [] if config.replay is None else read_recorded(config.replay)
    for observer in config.observers:
        observer.check_start()
    if resume is None:
        config.check_start()
    scene = processes.in_turn(lambda: config.dataset.build(config.data).load())
    if resume is None:
        # Photographs that were posed have become a scene of their own, which a later process reads.
        config = replace(config, data=scene.data or config.data)
        saved = config.start(scene)
    observers: list[Observer] = []

    def emit(event: Event) -> None:
        for observer in observers:
            observer.notify(event)

    def save_state(state: Mapping[str, Tensor], progress: Progress) -> None:
        write_checkpoint(folder / CHECKPOINTS, state, progress)

    frame = None if resume is not None else frame_of(scene, config.data)
    session = Session(
        scene, config, emit=emit, save_state=save_state, started=started, processes=processes, saved=saved
    )
    # The first process makes the folder, in which another may find what the first has written.
    folder = Path(processes.first(lambda: str(_run_folder(session, frame, resume, held))))
    try:
        with stop_on_interrupt() as stop_requested:
            if processes.leads:
                observers += [observer.build(folder) for observer in config.observers]
            if session.plan is not None:
                session.host.tell("plan", session.plan.values())
            _train(session, folder, observers, replay, stop_requested, resumed=resume is not None)
    finally:
        for observer in observers:
            observer.close()


def _take_up(folder: Path, held: ExitStack) -> None:
    """Hold the folder of a run that goes on, if it has checkpoints, and remove what it had half written."""
    if (folder / CHECKPOINTS).is_dir():
        held.enter_context(only_one(folder / CHECKPOINTS, "stop it"))
        remove_partial_files(folder)


def _tell_finished(folder: Path) -> None:
    """Say where the results are; a run that was killed before its report was written gets that now."""
    remove_partial_files(folder)
    if not (folder / REPORT_NAME).is_file():
        try:
            write_report(folder, load_finished(folder).pictures())
        except SculptError as error:
            _log.warning("no report: %s", error)
    sys.stdout.write(f"{folder} has finished already; its mesh is {folder / MESH_NAME}\n")


def _run_folder(session: Session, frame: WorldFrame | None, resume: Path | None, held: ExitStack) -> Path:
    """The run directory, ready to be written to; a new one, held from now on, with what is known of the world frame."""
    if resume is None:
        folder = prepare_output(session.config)
        write_atomically(folder / CONFIG_NAME, config_to_json(session.config).encode())
        if session.plan is not None:
            write_plan(session.plan, folder)
        if frame is not None:
            write_frame(frame, folder)
    else:
        folder = resume
    make_folder(folder / CHECKPOINTS)
    if resume is None:
        held.enter_context(only_one(folder / CHECKPOINTS, "stop it"))
    return folder


def _train(
    session: Session,
    folder: Path,
    observers: Sequence[Observer],
    replay: Sequence[Recorded],
    stop_requested: "StopFlag",
    *,
    resumed: bool,
) -> None:
    processes = session.host.processes
    intervals = [o.snapshot_seconds for o in observers if o.snapshot_seconds is not None]
    steering = Steering(
        session,
        folder=folder,
        sources=shared_commands([o.take_commands for o in observers if isinstance(o, SteeringObserver)], processes),
        replay=replay,
        interrupted=lambda: processes.first(stop_requested),
        snapshot_seconds=min(intervals) if intervals else None,
    )
    if resumed:
        steering.take_up(told_in(folder), session.step)
    try:
        for _ in session:
            if steering():
                session.stop()
    except ProcessLost:  # Noticed within a step, or when commands are shared between two.
        session.save_alone()
        raise
    processes.close()
    if not processes.leads:
        return
    files = session.save_result(folder)
    files |= {"curve": folder / "curve.csv", "run_dir": folder, "report": folder / REPORT_NAME}
    session.announce_end({kind: str(path) for kind, path in files.items()})
    try:
        write_report(folder, session.pictures())
    except SculptError as error:
        # The mesh is saved and measured: a page about it is not worth losing that.
        session.host.warn(f"no report: {error}")
    if session.failure is not None:
        raise TrainingFailed(f"{session.failure}; the best mesh until then is {files['mesh']}")


def told_in(folder: Path) -> list[Recorded]:
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
        numbers = (signal.SIGINT, signal.SIGBREAK if sys.platform == "win32" else signal.SIGTERM)
        previous = [(number, signal.signal(number, handle)) for number in numbers]
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

    folder: Path
    config: MethodConfig
    scene: Scene
    render: Callable[[Camera], Rendering]
    """How its result looks from a camera in world frame, on white."""

    def test_measures(self) -> dict[str, float | None]:
        """psnr (dB), ssim and iou, means over the test views, on white over whole images."""
        return image_measures(self.render, self.scene.test)

    def pictures(self) -> dict[str, dict[str, Picture]]:
        """A test view, or a train view if there is none, beside the result; as a run shows itself in its report."""
        view = (*self.scene.test, *self.scene.train)[0]
        pictures = view_pictures(self.render, load_mesh(self.folder / MESH_NAME), view, None)
        return {RESULT: {**image_picture(view), **pictures}}


def read_config(folder: Path) -> MethodConfig:
    """The config a run directory was made with. Raises CheckpointError if it is not a run directory."""
    path = folder / CONFIG_NAME
    if not path.is_file():
        raise CheckpointError(f"{folder} is not a run directory: it has no {CONFIG_NAME}")
    return config_from_json(path.read_text(encoding="utf-8"))


def load_finished(folder: Path) -> FinishedRun:
    """Read a run's result and its scene. Raises CheckpointError if the run has not left any."""
    config = read_config(folder)
    if not (folder / MESH_NAME).is_file():
        raise CheckpointError(f"{folder} has no {MESH_NAME}: the run has not finished; go on with --resume {folder}")
    scene = as_trained(config.dataset.build(config.data).load(), config)
    return FinishedRun(folder=folder, config=config, scene=scene, render=config.renderer(folder, scene))


def run_status(folder: Path) -> str | None:
    """How a run ended: finished, stopped or failed; None if it has not, or if that cannot be read any more."""
    path = folder / "metrics.json"
    try:
        metrics: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return metrics.get("status")
    except (OSError, ValueError, AttributeError):
        return None
