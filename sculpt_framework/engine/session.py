"""A session: a method at work on a scene, step by step, with all that is the same whatever the method is."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.config import MethodConfig
from sculpt_framework.cpu_kernels import CompileSeconds
from sculpt_framework.engine import announcements
from sculpt_framework.engine.clock import TrainingClock
from sculpt_framework.engine.known_good import KnownGood
from sculpt_framework.engine.measuring import Measuring
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.output import prepare_output
from sculpt_framework.engine.planning import planned
from sculpt_framework.engine.progress import Progress, Report, Saved, split_best, with_best
from sculpt_framework.engine.saving import CONFIG_NAME, save_result
from sculpt_framework.engine.schedule import Pace, Schedule
from sculpt_framework.engine.views import split_views, without_views
from sculpt_framework.errors import CheckpointError, TrainingFailed
from sculpt_framework.evaluation.album import Album
from sculpt_framework.evaluation.evaluator import Evaluator
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.painted import PaintedMesh
from sculpt_framework.evaluation.pictures import Picture
from sculpt_framework.events import Event, EventName
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.parallel.processes import Alone, Processes, ProcessLost
from sculpt_framework.reconstructor import Host, Moment, Reconstructor, StepReport
from sculpt_framework.serialization import config_to_json
from sculpt_framework.stop_rule import StopRule
from sculpt_framework.types import Camera, Rendering, Scene, View

_UNSTABLE = (FloatingPointError, EmptySurfaceError)
"""What a step or a measurement raises when the optimisation has gone wrong."""


class Session(Host):
    """Runs a method on a scene: ``for report in session`` begins, yields after the start and after every step, and
    finishes. Iterating again goes on where it was left: after a ``break``, an interrupt or ``stop``.

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
        self.processes = processes or Alone()
        began = time.monotonic() if started is None else started
        limit = config.max_time if max_time is None else float(max_time)
        config = replace(config, max_time=limit, data=config.data or scene.data)
        self.plan = None
        if saved is None:
            config, self.plan = planned(config, scene, self.processes)
        self.config = config = config.among(self.processes.count)
        self.scene = without_views(scene, config.skip_views)
        self._compiling = CompileSeconds()
        self.clock = TrainingClock(began, idle=self._compiling)
        self.step = 0 if saved is None else saved[1].outer
        """Steps taken."""
        self._emit_event, self._save_state, self._saved = emit, save_state, saved
        self._schedule = Schedule(config.steps, self.deadline(share_left=0.08, seconds_left=3.0))
        chosen, held_out = split_views(len(self.scene.train), config.holdout_every)
        self.views: Sequence[View] = [self.scene.train[index] for index in chosen]
        """What is learned from, in world frame."""
        self.evaluator = Evaluator(config, self.scene, held_out)
        milestones = Milestones(given=config.max_time)
        self._measuring = Measuring(self.evaluator, self.clock, milestones, self.processes, self.tell)
        self.reconstructor: Reconstructor = config.build(self.scene, self)
        shown = self.evaluator.views[:1] or self.views[:1]
        self._album = Album(shown[0], self.evaluator.reference)
        self.status = "finished"
        """How it ended: finished, stopped or failed."""
        self.failure: str | None = None
        """Why training ended early, if it failed; the result is the best there was then."""
        self._begun = self._stopping = self._finished = False
        self._known_good, self._pace = KnownGood(), Pace()
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
            self.clock.stop()

    def run(self) -> PaintedMesh:
        """All of it at once; raises as iterating does."""
        for _ in self:
            pass
        return self.mesh()

    def stop(self) -> None:
        """Take no more steps: the iteration finishes with what there is."""
        self._stopping = True

    def _begin(self) -> Report:
        told = announcements.run_started(self.config, self.scene, self.reconstructor.about())
        counts = {"views": len(self.views), "held_out": len(self.evaluator.views)}
        self.tell("run_started", {**told, **counts, "total_steps": self._schedule.total_steps})
        with self._compiling:
            self.clock.start()
            if self._saved is None:
                self.reconstructor.begin()
                self._enter_first_stage()
                self._schedule.begin()
                if self.timed and self.progress() >= 1.0:
                    self.warn(announcements.time_is_over(self.config))
            else:
                self._go_on_from(self._saved)
            self._begun = True
            return self._reported(None)

    def _next(self) -> float | None:
        """The progress at which a step is to be taken; None if no more are."""
        if self._finished:
            return None
        self.clock.start()
        if self.failure is not None or (progress := self._shared_progress()) >= 1.0:
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
        moment = Moment(step=self.step, progress=progress, rate=self._known_good.rate)
        method, stage = self.reconstructor, self.reconstructor.stage
        method.settle(moment)
        if method.stage != stage:
            self._milestones.enter_stage()
        # Here a surface has colours of its own, measuring it costs nothing twice, and the clock has gone on.
        measured = self._measure_if_due(self._shared_progress())
        self._known_good.latest = self._known_good.latest or measured or method.state()
        report = method.step(moment)
        self._known_good.latest = measured or self._known_good.latest  # A step has gone well from it.
        self.step += 1
        progress, psnr = self._schedule.progress(self.step), self._milestones.latest("psnr")
        eta = self._pace.left(progress, self.clock.train_seconds)
        self.tell("outer_step", announcements.step_taken(report, progress=progress, psnr=psnr, eta_seconds=eta))
        for told in report.decisions:
            self.tell("decision", told)
        return report

    def _fail(self, error: TrainingFailed) -> None:
        """End here, with the best there is; raises the error where there is nothing, or nobody to go on with."""
        if self._known_good.latest is None or isinstance(error, ProcessLost):
            raise error
        self.status, self.failure = "failed", str(error)
        self.warn(self.failure)

    def _recover(self, error: Exception) -> None:
        """Back to the last good state at half the learning rates; to the end after repeated failure."""
        known = self._known_good
        if (state := known.after_failure()) is None:
            self._fail(TrainingFailed(f"training cannot go on after {self.step} outer steps: {error}"))
            return
        self.reconstructor.load_state(state)
        self.tell("recovered", {"error": str(error), "rate_scale": known.rate, "attempt": known.returns})

    def _finish(self) -> None:
        """Choose the state to keep and have the method finish it."""
        with self._compiling:
            if self.failure is None:
                # Before the end changes anything, so that going on from here is as if there had been no stop.
                self.save_checkpoint()
            elif self._known_good.latest is not None:
                self.reconstructor.load_state(self._known_good.latest)
            progress = self._schedule.progress(self.step)
            try:
                self._keep_better(progress, trainable=self.failure is None)
            except _UNSTABLE as error:
                self._known_good.returns = 0  # This one is the last, and there is a result to be had by it.
                self._recover(error)
                self._keep_better(progress, trainable=False)
            self.reconstructor.finish()
            self.clock.stop()
            self._finished = True
            self._alone()  # What is left to do is the first one's.

    def _alone(self) -> None:
        self.processes = self._measuring.processes = Alone()
        self.reconstructor.alone()

    def _keep_better(self, progress: float, *, trainable: bool = True) -> float | None:
        """Go back to the best state if the last, settled if it can be, is worse. Returns the psnr of the one kept."""
        if trainable:
            self.reconstructor.settle(Moment(step=self.step, progress=progress, rate=self._known_good.rate, last=True))
        self._evaluate("end of optimisation", progress)
        latest, best = self._milestones.latest("psnr"), self._known_good.best_psnr
        if (state := self._known_good.better_than(latest)) is None:
            return latest
        self.tell("decision", {"item": "kept state", "value": "best", "psnr": best, "last_psnr": latest})
        self.reconstructor.load_state(state)
        return best

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
        return [dict(row) for row in self._milestones.rows]

    def save(self, folder: Path | str) -> dict[str, Path]:
        """Write what there is now into an empty or new folder: mesh.ply, mesh.glb, what the method has beside them, and
        config.json. Returns the files by kind. Raises OutputError where that cannot be, and as ``mesh``."""
        made = prepare_output(replace(self.config, output=Path(folder)))
        write_atomically(made / CONFIG_NAME, config_to_json(self.config).encode())
        return save_result(made, self.mesh(), self.reconstructor)

    def announce_end(self, files: Mapping[str, str]) -> None:
        """Measure the result and tell that the run is over and where its files are; the last event but for warnings."""
        self._evaluate("result", self._schedule.progress(self.step))
        told = announcements.run_ended(self.reconstructor, self._milestones, self.status, self.failure)
        self.tell("run_ended", {**told, **files, "seconds": self.clock.wall_seconds})

    def pictures(self) -> dict[str, dict[str, Picture]]:
        """A held-out view, or a train view if none is, beside what the run makes of it, and made of it at its start."""
        return self._album.pages(self.reconstructor)

    def _require_start(self) -> None:
        if not self._begun:
            raise TrainingFailed("there is no surface yet: the session has not made its start")

    # -- measuring -----------------------------------------------------------------------------------------------

    def _measure_if_due(self, progress: float) -> dict[str, Tensor] | None:
        """The state that was measured, if one was."""
        if (reason := self._measuring.due(progress)) is None:
            return None
        self._evaluate(reason, progress)
        if self.step == 0:
            with self.clock.pause():
                self._album.begin(self.reconstructor)
        self._end_if_level()
        return self.reconstructor.state()

    def _enter_first_stage(self) -> None:
        if self.reconstructor.begins_with_surface:
            self._milestones.enter_stage()
        else:
            self._milestones.wait()

    def _end_if_level(self) -> None:
        """Have a run that gains no more come to its end, and its rates with it."""
        rule, watched = StopRule(least_gain=self.config.level_gain_db), self._milestones.of_stage("psnr")
        ripe = self._in_last_stage and self.step >= self.config.steps
        if ripe and rule.stops(watched) and (factor := self._schedule.cut_short()) is not None:
            self._milestones.cut_short(factor)
            self.tell("decision", announcements.cut_short(rule.gain(watched), factor))

    def show_start(self, make: Callable[[], tuple[Mesh, Mapping[str, Any]] | None]) -> None:
        self._measuring.start(make)

    def _evaluate(self, reason: str, progress: float) -> None:
        self._measuring.method(reason, progress, self.reconstructor)
        self._schedule.end_by(self.deadline(share_left=0.0, seconds_left=3.0 + self._milestones.seconds_of_end))
        self._keep_best(reason, self._milestones.latest("psnr"))

    def _keep_best(self, reason: str, score: float | None) -> None:
        """Keep the state if its held-out views are the best of the last stage so far.

        Where the run counts steps, measurements at clock times are passed over: which state wins must not depend on how
        fast the machine is.
        """
        if score is not None and self._in_last_stage and (reason != "time" or self.config.max_time is not None):
            self._known_good.offer(score, self.reconstructor.state)

    @property
    def _milestones(self) -> Milestones:
        return self._measuring.milestones

    @property
    def _in_last_stage(self) -> bool:
        return self.reconstructor.stage == self.reconstructor.stages - 1

    # -- what the method is offered (``Host``), and telling --------------------------------------------------------

    @property
    def timed(self) -> bool:
        return self._schedule.timed

    def progress(self) -> float:
        return self._schedule.progress(self.step)

    def _shared_progress(self) -> float:
        return self.processes.first(self.progress)

    def deadline(self, *, share_left: float, seconds_left: float) -> float | None:
        return self.clock.deadline(self.config.max_time, share_left=share_left, seconds_left=seconds_left)

    @property
    def judged(self) -> bool:
        return bool(self.evaluator.views)

    def judge(self, render: Callable[[Camera], Float[Tensor, "h w 3"]]) -> float:
        return self.processes.first(lambda: self.evaluator.quick_psnr(render))

    def tell(self, name: EventName, data: Mapping[str, Any]) -> None:
        trained, passed = self.clock.train_seconds, self.clock.wall_seconds
        self._emit_event(Event(t_train=trained, t_wall=passed, outer=self.step, event=name, data=data))

    def warn(self, message: str) -> None:
        self.tell("warning", {"message": message})

    def _reported(self, report: StepReport | None) -> Report:
        self.clock.stop()
        loss, terms = (None, {}) if report is None else (report.loss, report.terms)
        return Report(step=self.step, progress=self._schedule.progress(self.step), loss=loss, terms=terms)

    # -- state ---------------------------------------------------------------------------------------------------

    def save_alone(self) -> None:
        """Where another process is lost, whoever is left saves: all hold the same."""
        self._alone()
        if self._begun:
            self.save_checkpoint()

    def save_checkpoint(self) -> None:
        """Hand the whole state to whoever keeps it."""
        if self._save_state is None or not self.processes.leads:
            return
        with self.clock.pause():
            progress = Progress(
                outer=self.step,
                progress=self._schedule.progress(self.step),
                trained_seconds=self.clock.train_seconds,
                best_psnr=self._known_good.best_psnr,
                rate_scale=self._known_good.rate,
                recoveries=self._known_good.returns,
                milestones=self._milestones.rows,
            )
            self._save_state(with_best(self.reconstructor.state(), self._known_good.best), progress)
            self._last_checkpoint = time.monotonic()
        self.tell("checkpoint", {"outer": self.step})

    def _go_on_from(self, saved: Saved) -> None:
        state, progress = saved
        self._measuring.milestones = Milestones(progress.milestones, self.config.max_time)
        if not self._milestones.staged:  # Stopped before the first step, which measures the first stage.
            self._enter_first_stage()
        self._schedule.begin(progress.progress)
        self.clock.go_on_from(progress.trained_seconds)
        latest, best = split_best(state)
        self._load(latest)
        self._known_good.take_up(progress, best)
        self.tell("action", {"message": f"going on after outer step {self.step}"})
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
