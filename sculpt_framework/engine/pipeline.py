"""A run from config to reconstruction: builds the components, holds the data flow, runs the bi-level trainer."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from sculpt_framework.config import MethodConfig, StageConfig
from sculpt_framework.cpu_kernels import CompileSeconds
from sculpt_framework.engine import announcements
from sculpt_framework.engine.clock import TrainingClock, process_start
from sculpt_framework.engine.images import pixel_footprint, prepare_image, prepare_images
from sculpt_framework.engine.measuring import Yardstick, resident_megabytes
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.parallel import Alone, Processes, ProcessLost
from sculpt_framework.engine.schedule import Pace, Schedule
from sculpt_framework.engine.view_pictures import Album
from sculpt_framework.errors import CheckpointError, TrainingFailed
from sculpt_framework.evaluation.pictures import Picture
from sculpt_framework.events import Event, EventName
from sculpt_framework.geometry.grid import RefineBox
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.losses import TrainingImage
from sculpt_framework.sculpting import assembly, foresight
from sculpt_framework.sculpting.assembly import Parts
from sculpt_framework.sculpting.idle_bands import spare_bands
from sculpt_framework.sculpting.initial_fit import fit_to_views
from sculpt_framework.sculpting.polish import polish
from sculpt_framework.sculpting.reconstruction import Reconstruction, reconstruct
from sculpt_framework.sculpting.silhouettes_first import shape_by_silhouettes
from sculpt_framework.sculpting.state import Progress, capture, restore, split_best, with_best
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.types import Scene, Surface

_RECOVERIES_AT_MOST = 3
_UNSTABLE = (FloatingPointError, EmptySurfaceError)
"""What a step or a measurement raises when the optimisation has gone wrong."""
_MARGIN_DB = 0.3
"""By which an earlier state's held-out views must be better: less is chance, and rates were higher then."""


class Pipeline:
    """``Pipeline(config).train()`` assembles and runs. Everything it does is told as events to ``emit``.

    ``should_stop`` is asked before each outer step; ``save`` is given the state to keep on disk at every checkpoint.
    """

    def __init__(
        self,
        config: MethodConfig,
        *,
        scene: Scene | None = None,
        emit: Callable[[Event], None] = lambda event: None,
        should_stop: Callable[[], bool] = lambda: False,
        save: Callable[[Mapping[str, Tensor], Progress], None] | None = None,
        started: float | None = None,
        processes: Processes | None = None,
    ):
        self.config = config
        loaded = scene if scene is not None else config.dataset.build(config.data).load()
        self.scene = assembly.without_views(loaded, config.skip_views)
        self._compiling = CompileSeconds()
        self.clock = TrainingClock(started if started is not None else process_start(), idle=self._compiling)
        self.outer = 0
        self._emit_event = emit
        self._should_stop, self._save = should_stop, save
        self._generator = torch.Generator().manual_seed(config.seed)
        self._parts = assembly.build_parts(config, self.scene.box, self._generator, processes)
        self._trainer = self._parts.trainer
        end = self.clock.deadline(config.max_time, share_left=0.08, seconds_left=3.0)
        self._schedule = Schedule(config.trainer, end)
        rasterizer, box, device = self._parts.rasterizer, self.scene.box, self._parts.device
        chosen, held_out = assembly.split_views(len(self.scene.train), config.trainer.holdout_every)
        self._views = [self.scene.train[index] for index in chosen]
        self._yardstick = Yardstick(config, self.scene, held_out, rasterizer, device)
        shown = self._yardstick.images[:1] or [prepare_image(self._views[0], box, 1.0, device, crop=False)]
        self._album = Album(rasterizer, shown[0], box, self._yardstick.reference, config.trainer.low_pass_px2)
        self._milestones = Milestones(given=config.max_time)
        self._stage_index = -1
        self._images: list[TrainingImage] = []
        self.failure: str | None = None
        """Why training ended early, if it failed; what it returned is the best it had then."""
        self._status = "finished"
        self._result: Surface | None = None
        """The surface training ended with, in the object frame; the Gaussians' rows are on it."""
        self._best: tuple[float, dict[str, Tensor]] | None = None
        self._last_good: dict[str, Tensor] | None = None
        self._rate_scale, self._recoveries, self._pace = 1.0, 0, Pace()
        self._last_checkpoint = time.monotonic()

    # -- the run -------------------------------------------------------------------------------------------------

    def train(self, resume: tuple[Mapping[str, Tensor], Progress] | None = None) -> Reconstruction:
        """Optimise and return the result; ``failure`` says whether that had to end early.

        Raises DataError if no start can be made from the data, and TrainingFailed if there never was a surface.
        """
        self._announce()
        with self._compiling:
            return self._train(resume)

    def _train(self, resume: tuple[Mapping[str, Tensor], Progress] | None) -> Reconstruction:
        self.clock.start()
        if resume is None:
            self._start()
            self._schedule.begin()
            foresight.check_time(self._schedule.progress(0), self.config, self.warn)
        else:
            self._resume(*resume)
        first = self._trainer.processes.first
        try:
            while (progress := first(lambda: self._schedule.progress(self.outer))) < 1.0:
                if self._should_stop():
                    self._status = "stopped"
                    break
                self._advance(progress)
            if self._trainer.seeds is None:
                self._enter_stage(progress)
            # Before the end changes anything, so that going on from here is as if there had been no stop.
            self.save_checkpoint()
        except ProcessLost:
            # Whoever is left saves: all hold the same.
            self._trainer.processes = Alone()
            self.save_checkpoint()
            raise
        except TrainingFailed as error:
            if self._last_good is None:
                raise
            self._status, self.failure = "failed", str(error)
            self._emit("warning", {"message": self.failure})
        return self._finish()

    def _start(self) -> None:
        """Fit the field to the initial surface and find the cells it passes through."""
        box, device, detail = self.scene.box, self._parts.device, self._parts.detail
        random, seen = self._generator, self._measure_start
        error = fit_to_views(self._trainer.field, self.config, self._views, box, detail, random, device, seen)
        self._trainer.equalize()
        self._emit("decision", announcements.initial_surface(self.config, error))
        for told in shape_by_silhouettes(self._parts, self.config, self._views, box, self.clock):
            self._emit("decision", told)

    def _advance(self, progress: float) -> None:
        """One outer step, with what comes before and after it."""
        try:
            self._step(self._enter_stage(progress), progress)
        except _UNSTABLE as error:
            self._recover(error)
        if time.monotonic() >= self._last_checkpoint + self.config.trainer.checkpoint_seconds:
            self.save_checkpoint()

    def _enter_stage(self, progress: float) -> StageConfig:
        index = self._schedule.stage_index(progress)
        stage = self.config.trainer.stages[index]
        if index == self._stage_index:
            return stage
        assembly.set_level(self._parts, stage.level)
        if self._trainer.seeds is None:
            assembly.find_seeds(self._parts)
        self._load_images(stage)
        self._trainer.begin_stage()
        self._stage_index = index
        self._announce_stage()
        self._milestones.enter_stage()
        return stage

    def _announce_stage(self) -> None:
        told = announcements.stage_entered(self._stage_index, self.config.trainer, self._trainer.extractor.grid)
        self._emit("stage", told)

    def _load_images(self, stage: StageConfig) -> None:
        box, device, number = self.scene.box, self._parts.device, self.config.trainer.stages.index(stage)
        foresight.check_memory(self._trainer, self._views, box, stage, number, self.warn)
        self._images = prepare_images(self._views, box, stage.image_scale, device)
        assembly.take_images(self._trainer, self.config.trainer, self._images)
        self._trainer.scene.blur = math.sqrt(self.config.trainer.low_pass_px2) * pixel_footprint(self._images)

    def _step(self, stage: StageConfig, progress: float) -> None:
        rate = self._schedule.rate_factor(progress) * self._rate_scale
        settled = self._trainer.settle(self._images, stage, rate, self._schedule.warm)
        # Here a surface has colours of its own, measuring it costs no extraction, and the clock has gone on.
        progress = self._trainer.processes.first(lambda: self._schedule.progress(self.outer))
        measured = self._measure_if_due(settled.surface.detach(), progress)
        report = self._trainer.update(settled, self._images, stage, self._schedule.surface_rate(rate, self.outer))
        self._last_good = measured or self._last_good  # A step has gone well from it.
        self.outer += 1
        progress, psnr = self._schedule.progress(self.outer), self._milestones.latest("psnr")
        eta = self._pace.left(progress, self.clock.train_seconds)
        self._emit("outer_step", announcements.outer_step(report, progress=progress, psnr=psnr, eta_seconds=eta))
        bands = spare_bands(self._trainer, settled.binding, self._yardstick, self.config.trainer, self.outer)
        for told in (*self._trainer.resting.news(), *bands):
            self._emit("decision", told)

    def _recover(self, error: Exception) -> None:
        """Back to the last good state at half the learning rates; give up after repeated failure."""
        self._recoveries += 1
        if self._last_good is None or self._recoveries > _RECOVERIES_AT_MOST:
            raise TrainingFailed(f"training cannot go on after {self.outer} outer steps: {error}") from error
        self._rate_scale *= 0.5
        self._return_to(self._last_good)
        self._emit("recovered", {"error": str(error), "rate_scale": self._rate_scale, "attempt": self._recoveries})

    def _return_to(self, state: Mapping[str, Tensor]) -> None:
        """Load a captured state, whatever stage it is of. If that is not the current stage, it is entered again."""
        index = int(state["stage"])
        grid = self._parts.grid.at_level(self.config.trainer.stages[index].level)
        self._trainer.extractor.set_grid(grid)
        self._trainer.field.set_detail(self._parts.detail)
        restore(self._trainer, self._generator, state)
        assembly.fit_seeds(self._parts)
        self._stage_index = index

    def _finish(self) -> Reconstruction:
        """Choose the state to keep and learn its colours to the end."""
        trainer, progress = self._trainer, self._schedule.progress(self.outer)
        if self._status == "failed" and self._last_good is not None:
            self._return_to(self._last_good)
        try:
            self._keep_better(progress, trainable=self._status != "failed")
        except _UNSTABLE as error:
            self._recoveries = 0  # This one is the last, and there is a result to be had by it.
            self._recover(error)
            self._keep_better(progress, trainable=False)
        surface = self._follow_surface()
        kept = capture(trainer, self._stage_index, self._generator)
        try:
            self._polish(surface)
        except FloatingPointError as error:
            self._emit("warning", {"message": f"colours are as training left them: {error}"})
            self._return_to(kept)
            surface = self._follow_surface()
        self.clock.stop()
        trainer.processes = Alone()  # What is left to do is the first one's.
        self._result = surface
        return reconstruct(trainer.scene, surface, self.scene.box)

    def _keep_better(self, progress: float, *, trainable: bool = True) -> float | None:
        """Go back to the best state if the last, settled if it can be, is worse. Returns the psnr of the one kept."""
        surface, stage = None, self.config.trainer.stages[self._stage_index]
        if trainable:
            rate = self._schedule.rate_factor(progress) * self._rate_scale
            surface = self._trainer.settle(self._images, stage, rate, self._schedule.warm).surface.detach()
        self._evaluate("end of optimisation", progress, surface or self._follow_surface())
        latest = self._milestones.latest("psnr")
        if self._best is None or latest is None or self._best[0] <= latest + _MARGIN_DB:
            return latest
        self._emit("decision", {"item": "kept state", "value": "best", "psnr": self._best[0], "last_psnr": latest})
        self._return_to(self._best[1])
        return self._best[0]

    def _polish(self, surface: Surface) -> None:
        """Colours on the final surface, for as many steps as the method says and the time limit allows."""
        end = self.clock.deadline(self.config.max_time, share_left=0.025, seconds_left=2.0)
        for told in polish(self._trainer, surface, self._images, self._yardstick, self.config.trainer, end):
            self._emit("decision", told)

    def _follow_surface(self) -> Surface:
        """The current surface without gradient, with the Gaussians' rows on it."""
        surface = self._trainer.extract().surface.detach()
        self._trainer.scene.follow(surface)
        return surface

    # -- measuring and telling -----------------------------------------------------------------------------------

    def _measure_if_due(self, surface: Surface, progress: float) -> dict[str, Tensor] | None:
        """The state that was measured, if one was."""
        due, clock = self._milestones.due, self.clock
        if (reason := self._trainer.processes.first(lambda: due(progress, clock.train_seconds))) is None:
            return None
        self._evaluate(reason, progress, surface)
        if self.outer == 0:
            with self.clock.pause():
                self._album.begin(self._trainer.scene, surface)
        self._end_if_level()
        state = capture(self._trainer, self._stage_index, self._generator)
        self._last_good = self._last_good or state
        return state

    def _end_if_level(self) -> None:
        """Have a run that gains no more come to its end, and its rates with it."""
        config, gain = self.config.trainer, self._milestones.gain()
        last = self._stage_index == len(config.stages) - 1 and self.outer >= config.outer_steps
        if last and gain < config.level_gain_db > 0 and (factor := self._schedule.cut_short()) is not None:
            self._milestones.cut_short(factor)
            self._emit("decision", announcements.cut_short(gain, factor))

    def _measure_start(self, target: SdfFunction) -> None:
        """A row about what the initializer has made so far, if that is a surface."""
        if not self._trainer.processes.first(self._milestones.start_due):
            return
        extractor = self.config.extractor.build(self._trainer.extractor.grid, self._parts.device)
        self._add_row("start", 0.0, lambda: self._yardstick.measure_start(target, extractor, self._parts.device))

    def _evaluate(self, reason: str, progress: float, surface: Surface) -> None:
        """Measure a surface (object frame) that the Gaussians' rows are on."""
        self._add_row(reason, progress, lambda: self._measured(surface))
        self._keep_best(reason, self._milestones.latest("psnr"))

    def _add_row(self, reason: str, progress: float, measure: Callable[[], dict[str, Any] | None]) -> None:
        """A row of the curve, if there is something to tell; the clock stands still meanwhile."""
        began = self.clock.now
        with self.clock.pause(), torch.no_grad():
            measured = self._trainer.processes.first(measure)
        seconds = self.clock.now - began
        self._milestones.charge(seconds)
        if measured is not None:
            row = {"reason": reason, "progress": progress, "t_cpu_s": self.clock.cpu_seconds, **measured}
            self._milestones.add(progress, row)
            self._emit("evaluation", {**row, "seconds": seconds})

    def _measured(self, surface: Surface) -> dict[str, Any]:
        """On held-out views and against the reference; of the result, all there is to measure."""
        measure = self._yardstick.measure if self._result is None else self._yardstick.measure_result
        return announcements.sizes(self._trainer, surface) | measure(self._trainer.scene, surface)

    def _keep_best(self, reason: str, score: float | None) -> None:
        """Keep the state if its held-out views are the best of the last stage so far.

        Where the run counts steps, measurements at clock times are passed over: which state wins must not depend on how
        fast the machine is.
        """
        last, timed = self._stage_index == len(self.config.trainer.stages) - 1, self.config.max_time is not None
        if score is None or not last or (reason == "time" and not timed):
            return
        if self._best is None or score > self._best[0]:
            self._best = (score, capture(self._trainer, self._stage_index, self._generator))

    def announce_end(self, result: Reconstruction, files: Mapping[str, str]) -> None:
        """Measure the result and tell that the run is over and where its files are; the last event but for warnings."""
        self._evaluate("result", self._schedule.progress(self.outer), self._trained)
        final, mesh = dict(self._milestones.rows[-1]), result.mesh
        final |= {"faces": len(mesh.faces), "gaussians": len(result.gaussians), "rss_mb": resident_megabytes()}
        shares = self._milestones.shares()
        data = announcements.run_ended(mesh, status=self._status, failure=self.failure, final=final, milestones=shares)
        self._emit("run_ended", {**data, **files, "seconds": self.clock.wall_seconds})

    def pictures(self) -> dict[str, dict[str, Picture]]:
        """A held-out view, or a train view if none is, beside what the run makes of it, and made of it at its start."""
        return self._album.pages(self._trainer.scene, self._trained)

    @property
    def _trained(self) -> Surface:
        assert self._result is not None, "there is a result once training has ended"  # noqa: S101
        return self._result

    def warn(self, message: str) -> None:
        """Tell of something that went wrong but ends nothing."""
        self._emit("warning", {"message": message})

    def _announce(self) -> None:
        views, held_out, steps = len(self._views), len(self._yardstick.images), self._schedule.total_steps
        data = announcements.run_started(self.config, self.scene, self._parts, views, held_out, steps)
        self._emit("run_started", data)

    def _emit(self, name: EventName, data: Mapping[str, Any]) -> None:
        trained, passed = self.clock.train_seconds, self.clock.wall_seconds
        self._emit_event(Event(t_train=trained, t_wall=passed, outer=self.outer, event=name, data=data))

    @property
    def parts(self) -> Parts:
        """What is steered between two steps."""
        return self._parts

    def refine(self, boxes: Sequence[RefineBox]) -> None:
        """Refine in these boxes (object frame) and nowhere else from now on. Raises ValueError as ``refine_in``."""
        self._parts = assembly.refine_in(self._parts, boxes, max(stage.level for stage in self.config.trainer.stages))

    def current(self) -> Reconstruction:
        """The surface as of the latest extraction. Raises ValueError before the first."""
        if self._trainer.extraction is None:
            raise ValueError("there is no surface yet")
        return reconstruct(self._trainer.scene, self._trainer.extraction.surface.detach(), self.scene.box)

    # -- state ---------------------------------------------------------------------------------------------------

    def save_checkpoint(self) -> None:
        """Hand the whole state to whoever keeps it."""
        if self._save is None or self._trainer.seeds is None or not self._trainer.processes.leads:
            return
        with self.clock.pause():
            progress = Progress(
                outer=self.outer,
                progress=self._schedule.progress(self.outer),
                trained_seconds=self.clock.train_seconds,
                best_psnr=None if self._best is None else self._best[0],
                rate_scale=self._rate_scale,
                recoveries=self._recoveries,
                milestones=self._milestones.rows,
            )
            state = capture(self._trainer, self._stage_index, self._generator)
            self._save(with_best(state, None if self._best is None else self._best[1]), progress)
            self._last_checkpoint = time.monotonic()
        self._emit("checkpoint", {"outer": self.outer})

    def _resume(self, state: Mapping[str, Tensor], progress: Progress) -> None:
        self.outer = progress.outer
        self._rate_scale, self._recoveries = progress.rate_scale, progress.recoveries
        self._milestones = Milestones(progress.milestones, self.config.max_time)
        if not self._milestones.staged:  # Stopped before the first step, which measures the first stage.
            self._milestones.enter_stage()
        self._schedule.begin(progress.progress)
        latest, best = split_best(state)
        try:
            self._return_to(latest)
        except (KeyError, RuntimeError) as error:
            raise CheckpointError(f"the checkpoint does not fit the run's config.json ({error})") from error
        if progress.best_psnr is not None:
            self._best = (progress.best_psnr, best)
        self._load_images(self.config.trainer.stages[self._stage_index])
        self.clock.go_on_from(progress.trained_seconds)
        self._emit("action", {"message": f"going on after outer step {self.outer}"})
        self._announce_stage()
        self._last_good = capture(self._trainer, self._stage_index, self._generator)

    def at_result(self, saved: tuple[Mapping[str, Tensor], Progress]) -> tuple[BiLevelTrainer, float | None]:
        """The trainer as the result of a finished run was made by it, and the psnr of that on the held-out views."""
        self._resume(*saved)
        return self._trainer, self._keep_better(1.0)
