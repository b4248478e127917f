"""A session: a method at work on a scene, step by step, with all that is the same whatever the method is."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from sculpt_framework.config import MethodConfig
from sculpt_framework.cpu_kernels import CompileSeconds
from sculpt_framework.engine import announcements
from sculpt_framework.engine.checkpoint import Progress, Saved, split_best, with_best
from sculpt_framework.engine.clock import TrainingClock
from sculpt_framework.engine.hosting import Hosting
from sculpt_framework.engine.known_good import KnownGood
from sculpt_framework.engine.measuring import Measuring
from sculpt_framework.engine.output import CONFIG_NAME, MESH_NAME, prepare_output
from sculpt_framework.engine.planning import planned, without_views
from sculpt_framework.engine.schedule import Pace
from sculpt_framework.errors import CheckpointError, TrainingFailed
from sculpt_framework.evaluation.painted import PaintedMesh
from sculpt_framework.evaluation.pictures import Picture
from sculpt_framework.events import Event
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_ply
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.parallel.processes import Alone, Processes, ProcessLost
from sculpt_framework.reconstructor import Moment, Reconstructor, StepReport
from sculpt_framework.serialization import config_to_json
from sculpt_framework.types import Camera, Rendering, Scene

_UNSTABLE = (FloatingPointError, EmptySurfaceError)
"""What a step or a measurement raises when the optimisation has gone wrong."""


@dataclass(frozen=True, kw_only=True)
class Report:
    """Where a session stands after its start, and after each step."""

    step: int
    """Steps taken; 0 right after the start."""
    progress: float
    """Share of the run that is done."""
    loss: float | None
    """Of this step; None after the start, and after a step that failed and was taken back."""
    terms: Mapping[str, float]


class Session:
    """Runs a method on a scene: ``for report in session`` begins, yields after the start and after every step, and
    finishes. Iterating again goes on where it was left by a ``break`` or an interrupt; after ``stop`` it is finished.

    The scene is looked at for what it does not need, and the method built, at once; ``config`` and ``plan`` say what
    came of it. The clock starts then. Nothing is printed or written: what happens is told as events to ``emit``, and
    ``save_state`` is given the state to keep at every checkpoint.
    """

    def __init__(
        self,
        scene: Scene,
        config: MethodConfig,
        *,
        max_time: float | int | None = None,
        emit: Callable[[Event], None] = lambda event: None,
        save_state: Callable[[Mapping[str, Tensor], Progress], None] | None = None,
        started: float | None = None,
        processes: Processes | None = None,
        saved: Saved | None = None,
    ):
        """``max_time`` is seconds until the result is there, the config's if None; ``started`` the ``time.monotonic()``
        instant they count from, now if None. With ``saved``, a checkpoint to go on from, the config is taken as it is.
        Raises SculptError for what the user can mend."""
        processes = processes or Alone()
        began = time.monotonic() if started is None else started
        limit = config.max_time if max_time is None else float(max_time)
        config = replace(config, max_time=limit, data=config.data or scene.data)
        self.plan = None
        if saved is None:
            config, self.plan = planned(config, scene, processes)
        self.config = config = config.among(processes.count)
        self.scene = without_views(scene, config.skip_views)
        self._compiling = CompileSeconds()
        self._save_state, self._saved = save_state, saved
        self.host = Hosting(
            self.scene,
            config,
            clock=TrainingClock(began, idle=self._compiling),
            processes=processes,
            emit=emit,
            saved=None if saved is None else saved[1],
        )
        """Where the run stands; what the method is offered."""
        self.reconstructor: Reconstructor = config.build(self.scene, self.host)
        self.status = "finished"
        """How it ended: finished, stopped or failed."""
        self.failure: str | None = None
        """Why training ended early, if it failed; the result is the best there was then."""
        self._begun = self._stopping = self._finished = False
        self._known_good, self._pace = KnownGood(), Pace()
        self._measuring = Measuring(self.host, self.reconstructor, self._known_good)
        self._last_checkpoint = time.monotonic()

    # -- the run -------------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Report]:
        """Raises DataError if no start can be made, TrainingFailed if there never was a surface."""
        try:
            if not self._begun:
                yield self._begin()
            while (progress := self._next()) is not None:
                yield self._advance(progress)
            if not self._finished:
                self._finish()
        finally:
            self.host.clock.stop()

    def run(self) -> PaintedMesh:
        """All of it at once; raises as iterating does."""
        for _ in self:
            pass
        return self.mesh()

    @property
    def step(self) -> int:
        """Steps taken."""
        return self.host.step

    def stop(self) -> None:
        """Take no more steps: the iteration finishes with what there is."""
        self._stopping = True

    def _begin(self) -> Report:
        told = announcements.run_started(self.config, self.scene, self.reconstructor.about())
        host = self.host
        counts = {"views": len(host.views), "held_out": len(host.evaluator.views)}
        host.tell("run_started", {**told, **counts, "total_steps": host.schedule.total_steps})
        with self._compiling:
            host.clock.start()
            if self._saved is None:
                self.reconstructor.begin()
                self._measuring.begin()
                host.schedule.begin()
                if host.timed and host.progress() >= 1.0:
                    host.warn(announcements.time_is_over(self.config))
            else:
                self._go_on_from(self._saved)
            self._begun = True
            return self._reported(None)

    def _next(self) -> float | None:
        """The progress at which a step is to be taken; None if no more are."""
        if self._finished:
            return None
        self.host.clock.start()
        if self.failure is not None or (progress := self.host.shared_progress()) >= 1.0:
            return None
        if self._stopping:
            self._stopping, self.status = False, "stopped"
            return None
        return progress

    def _advance(self, progress: float) -> Report:
        """One step, with what comes before and after it."""
        report = None
        with self._compiling:
            try:
                report = self._take_step(progress)
            except _UNSTABLE as error:
                self._recover(error)
            except TrainingFailed as error:
                self._fail(error)
            if time.monotonic() >= self._last_checkpoint + self.config.checkpoint_seconds:
                self.save_checkpoint()
            return self._reported(report)

    def _take_step(self, progress: float) -> StepReport:
        host, method, stage = self.host, self.reconstructor, self.reconstructor.stage
        moment = Moment(step=host.step, progress=progress, rate=self._known_good.rate)
        method.settle(moment)
        if method.stage != stage:
            host.milestones.enter_stage()
        # Here a surface has colours of its own, measuring it costs nothing twice, and the clock has gone on.
        measured = self._measuring.if_due()
        self._known_good.latest = self._known_good.latest or measured or method.state()
        report = method.step(moment)
        self._known_good.latest = measured or self._known_good.latest  # A step has gone well from it.
        host.step += 1
        progress, psnr = host.progress(), host.milestones.latest("psnr")
        eta = self._pace.left(progress, host.clock.train_seconds)
        host.tell("outer_step", announcements.step_taken(report, progress=progress, psnr=psnr, eta_seconds=eta))
        for told in report.decisions:
            host.tell("decision", told)
        return report

    def _fail(self, error: TrainingFailed) -> None:
        """End here, with the best there is; raises the error where there is nothing, or nobody to go on with."""
        if self._known_good.latest is None or isinstance(error, ProcessLost):
            raise error
        self.status, self.failure = "failed", str(error)
        self.host.warn(self.failure)

    def _recover(self, error: Exception) -> None:
        """Back to the last good state at half the learning rates; to the end after repeated failure."""
        known = self._known_good
        if (state := known.after_failure()) is None:
            self._fail(TrainingFailed(f"training cannot go on after {self.step} outer steps: {error}"))
            return
        self.reconstructor.load_state(state)
        self.host.tell("recovered", {"error": str(error), "rate_scale": known.rate, "attempt": known.returns})

    def _finish(self) -> None:
        """Choose the state to keep and have the method finish it."""
        with self._compiling:
            if self.failure is None:
                # Before the end changes anything, so that going on from here is as if there had been no stop.
                self.save_checkpoint()
            elif self._known_good.latest is not None:
                self.reconstructor.load_state(self._known_good.latest)
            progress = self.host.shared_progress()
            try:
                self._keep_better(progress, trainable=self.failure is None)
            except _UNSTABLE as error:
                self._known_good.returns = 0  # This one is the last, and there is a result to be had by it.
                self._recover(error)
                self._keep_better(progress, trainable=False)
            self.reconstructor.finish()
            self.host.clock.stop()
            self._finished = True
            self._alone()  # What is left to do is the first one's.

    def _alone(self) -> None:
        self.host.processes = Alone()
        self.reconstructor.alone()

    def _keep_better(self, progress: float, *, trainable: bool = True) -> float | None:
        """Go back to the best state if the last, settled if it can be, is worse. Returns the psnr of the one kept."""
        if trainable:
            self.reconstructor.settle(Moment(step=self.step, progress=progress, rate=self._known_good.rate, last=True))
        self._measuring.measure("end of optimisation", progress)
        latest, best = self.host.milestones.latest("psnr"), self._known_good.best_psnr
        if (state := self._known_good.better_than(latest)) is None:
            return latest
        self.host.tell("decision", {"item": "kept state", "value": "best", "psnr": best, "last_psnr": latest})
        self.reconstructor.load_state(state)
        return best

    def _reported(self, report: StepReport | None) -> Report:
        self.host.clock.stop()
        loss, terms = (None, {}) if report is None else (report.loss, report.terms)
        return Report(step=self.host.step, progress=self.host.progress(), loss=loss, terms=terms)

    # -- what comes of it ----------------------------------------------------------------------------------------

    def mesh(self) -> PaintedMesh:
        """The surface now, or the result; world frame. Raises TrainingFailed before the start is made."""
        self._require_start()
        colors, mesh = self.reconstructor.colors(), self.reconstructor.mesh()
        return PaintedMesh(vertices=mesh.vertices, faces=mesh.faces, colors=colors)

    def render(self, camera: Camera) -> Rendering:
        """How it looks now from a camera in world frame, on white. Raises as ``mesh``."""
        self._require_start()
        return self.reconstructor.render(camera)

    @property
    def curve(self) -> Sequence[Mapping[str, Any]]:
        """What was measured so far, a row each, as in curve.csv (docs/reference/measures.md)."""
        return [dict(row) for row in self.host.milestones.rows]

    def save(self, folder: Path | str) -> dict[str, Path]:
        """Write what there is now into an empty or new folder: mesh.ply, mesh.glb, what the method has beside them, and
        config.json. Returns the files by kind. Raises OutputError where that cannot be, and as ``mesh``."""
        made = prepare_output(replace(self.config, output=Path(folder)))
        write_atomically(made / CONFIG_NAME, config_to_json(self.config).encode())
        return self.save_result(made)

    def save_result(self, folder: Path) -> dict[str, Path]:
        """``save`` into a folder that has its config.json already."""
        mesh, paths = self.mesh(), {"mesh": folder / MESH_NAME, "glb": folder / "mesh.glb"}
        write_mesh_ply(paths["mesh"], mesh.vertices, mesh.faces, mesh.colors)
        write_mesh_glb(paths["glb"], mesh.vertices, mesh.faces, mesh.colors)
        return paths | self.reconstructor.save(folder)

    def announce_end(self, files: Mapping[str, str]) -> None:
        """Measure the result and tell that the run is over and where its files are; the last event but for warnings."""
        self._measuring.measure("result", self.host.progress())
        told = announcements.run_ended(self.reconstructor, self.host.milestones, self.status, self.failure)
        self.host.tell("run_ended", {**told, **files, "seconds": self.host.clock.wall_seconds})

    def pictures(self) -> dict[str, dict[str, Picture]]:
        """A held-out view, or a train view if none is, beside what the run makes of it, and made of it at its start."""
        return self._measuring.pictures()

    def _require_start(self) -> None:
        if not self._begun:
            raise TrainingFailed("there is no surface yet: the session has not made its start")

    # -- state ---------------------------------------------------------------------------------------------------

    def save_alone(self) -> None:
        """Where another process is lost, whoever is left saves: all hold the same."""
        self._alone()
        if self._begun:
            self.save_checkpoint()

    def save_checkpoint(self) -> None:
        """Hand the whole state to whoever keeps it."""
        if self._save_state is None or not self.host.processes.leads:
            return
        with self.host.clock.pause():
            progress = Progress(
                outer=self.step,
                progress=self.host.progress(),
                trained_seconds=self.host.clock.train_seconds,
                best_psnr=self._known_good.best_psnr,
                rate_scale=self._known_good.rate,
                recoveries=self._known_good.returns,
                milestones=self.host.milestones.rows,
            )
            self._save_state(with_best(self.reconstructor.state(), self._known_good.best), progress)
            self._last_checkpoint = time.monotonic()
        self.host.tell("checkpoint", {"outer": self.step})

    def _go_on_from(self, saved: Saved) -> None:
        state, progress = saved
        self._measuring.begin()
        self.host.schedule.begin(progress.progress)
        self.host.clock.go_on_from(progress.trained_seconds)
        latest, best = split_best(state)
        self._load(latest)
        self._known_good.take_up(progress, best)
        self.host.tell("action", {"message": f"going on after outer step {self.step}"})
        self._known_good.latest = self.reconstructor.state()

    def _load(self, state: Mapping[str, Tensor]) -> None:
        try:
            self.reconstructor.load_state(state)
        except (KeyError, RuntimeError) as error:
            raise CheckpointError(f"the checkpoint does not fit the run's config.json ({error})") from error

    def show_saved(self) -> None:
        """Have the method in the state that the session was given to go on from; no more is done."""
        assert self._saved is not None  # noqa: S101
        self._load(split_best(self._saved[0])[0])

    def at_result(self) -> float | None:
        """Have the method in the state that the result of the saved run was made of. Returns that state's psnr on the
        held-out views."""
        self._begin()
        return self._keep_better(1.0)
