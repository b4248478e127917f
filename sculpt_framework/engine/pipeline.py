"""A run from config to reconstruction: builds the components, holds the data flow, runs the bi-level trainer."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from sculpt_framework.config import MethodConfig, StageConfig
from sculpt_framework.engine.assembly import build_parts, split_views
from sculpt_framework.engine.clock import TrainingClock, process_start
from sculpt_framework.engine.events import Event, EventName
from sculpt_framework.engine.images import TrainingImage, pixel_footprint, prepare_image, prepare_images
from sculpt_framework.engine.initial_fit import fit_field
from sculpt_framework.engine.measuring import image_measures, mesh_measures, resident_megabytes
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.engine.reconstruction import Reconstruction, object_gaussians, reconstruct, world_mesh
from sculpt_framework.engine.schedule import Schedule
from sculpt_framework.engine.state import capture, restore
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.extractors import EmptySurfaceError
from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import refine_cells
from sculpt_framework.types import Scene, View

_CURVE_SAMPLES = 20_000
_FINAL_SAMPLES = 200_000
_HELD_OUT_AT_MOST = 10
"""More views than this add evaluation time, not knowledge."""
_RECOVERIES_AT_MOST = 3
_LIPSCHITZ = 1.5
"""A fitted field is not quite a distance: cells are searched as if it could be this much steeper."""
_INITIAL_CELLS = 64
"""Cells along the longest side at which the initial surface is tabulated."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a run stood when it was saved; with the captured tensors, all that resuming needs."""

    outer: int
    trained_seconds: float
    stage: int
    best_psnr: float | None
    rate_scale: float
    milestones: list[dict[str, Any]]


class TrainingFailed(RuntimeError):
    """Training could not go on, after repeated recovery; the message names what failed."""


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
        snapshot_seconds: float | None = None,
        started: float | None = None,
    ):
        self.config = config
        self.scene = scene if scene is not None else config.dataset.build(config.data).load()
        self.clock = TrainingClock(started if started is not None else process_start())
        self.outer = 0
        self._emit_event = emit
        self._should_stop = should_stop
        self._save = save
        self._snapshot_seconds = snapshot_seconds
        self._generator = torch.Generator().manual_seed(config.seed)
        self._parts = build_parts(config, self.scene.box, self._generator)
        self._trainer = self._parts.trainer
        self._schedule = Schedule(config.trainer, self._deadline())
        chosen, held_out = split_views(len(self.scene.train), config.trainer.holdout_every)
        self._views = [self.scene.train[index] for index in chosen]
        self._held_out = [self._whole_image(self.scene.train[index]) for index in held_out[:_HELD_OUT_AT_MOST]]
        reference = config.reference or self.scene.reference_mesh
        self._reference = None if reference is None else MeasuredMesh(load_mesh(reference), _CURVE_SAMPLES)
        self._milestones = Milestones()
        self._stage_index = -1
        self._images: list[TrainingImage] = []
        self._final: dict[str, Any] = {}
        self._best: tuple[float, dict[str, Tensor]] | None = None
        self._last_good: dict[str, Tensor] | None = None
        self._rate_scale = 1.0
        self._recoveries = 0
        self._evaluation_seconds = 0.0
        self._last_snapshot = float("-inf")
        self._last_checkpoint = time.monotonic()

    # -- the run -------------------------------------------------------------------------------------------------

    def train(self, resume: tuple[Mapping[str, Tensor], Progress] | None = None) -> Reconstruction:
        """Optimise and return the result. Raises TrainingFailed, or DataError if no start can be made from the data."""
        self._announce()
        self.clock.start()
        self._schedule.begin()
        if resume is None:
            self._start()
        else:
            self._resume(*resume)
        stopped = False
        while (progress := self._schedule.progress(self.outer)) < 1.0:
            if self._should_stop():
                stopped = True
                break
            stage = self._enter_stage(progress)
            self._step(stage, progress)
            self._report_if_due(self._schedule.progress(self.outer))
        return self._finish("stopped" if stopped else "finished")

    def _start(self) -> None:
        """Fit the field to the initial surface and find the cells it passes through."""
        device = self._parts.device
        initializer = self.config.initializer.build()
        views = [self._in_object_frame(view) for view in self._views]
        target = initializer.target(views, self.scene.box.half_sides, device)
        level = 0
        while self.config.trainer.base_cells << (level + 1) <= _INITIAL_CELLS:
            level += 1
        # Only the levels of detail that the first stage uses: finer ones would wake up later with stale detail.
        self._trainer.field.set_detail(self._parts.grid.at_level(self.config.trainer.stages[0].level).cell)
        error = fit_field(
            self._trainer.field,
            target,
            self._parts.grid.at_level(level),
            steps=self.config.trainer.fit_steps,
            generator=self._generator,
            device=device,
        )
        self._emit("decision", {"item": "initial surface", "value": type(initializer).__name__, "fit_error": error})

    def _enter_stage(self, progress: float) -> StageConfig:
        index = self._schedule.stage_index(progress)
        stage = self.config.trainer.stages[index]
        if index == self._stage_index:
            return stage
        self._set_level(stage.level)
        self._load_images(stage)
        self._trainer.view_order = []
        self._stage_index = index
        if self._trainer.seeds is None:
            self._discover()
        grid = self._trainer.extractor.grid
        self._emit(
            "stage",
            {
                "index": index,
                "count": len(self.config.trainer.stages),
                "level": stage.level,
                "grid": list(grid.shape),
                "image_scale": stage.image_scale,
                "inner_steps": stage.inner_steps,
                "silhouette_only": stage.silhouette_only,
            },
        )
        self._evaluate("stage", progress)
        self._keep_good()
        return stage

    def _load_images(self, stage: StageConfig) -> None:
        self._images = prepare_images(self._views, self.scene.box, stage.image_scale, self._parts.device)
        pixel = pixel_footprint(self._images)
        self._trainer.scene.blur = math.sqrt(self.config.trainer.low_pass_px2) * pixel

    def _set_level(self, level: int) -> None:
        trainer, grid = self._trainer, self._parts.grid.at_level(level)
        if trainer.extractor.grid == grid and trainer.extraction is not None:
            return
        trainer.extractor.set_grid(grid)
        trainer.field.set_detail(grid.cell)
        if trainer.extraction is not None:
            # The surface's cells on the old level hold those on the new one, and the extraction follows it from there.
            trainer.seeds = refine_cells(trainer.extraction.cells, trainer.extraction.grid, grid)

    def _discover(self) -> None:
        field, grid = self._trainer.field, self._trainer.extractor.grid
        self._trainer.seeds = discover(
            lambda points: field(points).sdf, grid, coarse_level=0, lipschitz=_LIPSCHITZ, device=self._parts.device
        )

    def _step(self, stage: StageConfig, progress: float) -> None:
        try:
            report = self._trainer.outer_step(
                self._images, stage, self._schedule.rate_factor(progress) * self._rate_scale
            )
        except (FloatingPointError, EmptySurfaceError) as error:
            self._recover(error)
            return
        self.outer += 1
        self._emit(
            "outer_step",
            {
                "progress": self._schedule.progress(self.outer),
                "loss": report.loss,
                "terms": report.terms,
                "inner_loss": report.inner_loss,
                "faces": report.faces,
                "gaussians": report.gaussians,
                "psnr": self._milestones.latest("psnr"),
                "rss_mb": resident_megabytes(),
                "eta_s": self._eta(),
            },
        )

    def _recover(self, error: Exception) -> None:
        """Back to the last good state at half the learning rates; give up after repeated failure."""
        self._recoveries += 1
        if self._last_good is None or self._recoveries > _RECOVERIES_AT_MOST:
            raise TrainingFailed(f"training cannot go on after {self.outer} outer steps: {error}") from error
        self._rate_scale *= 0.5
        restore(self._trainer, self._generator, self._last_good)
        self._emit("recovered", {"error": str(error), "rate_scale": self._rate_scale, "attempt": self._recoveries})

    def _finish(self, status: str) -> Reconstruction:
        trainer = self._trainer
        if self._trainer.seeds is None:
            self._enter_stage(0.0)
        self._evaluate("end of optimisation", 1.0)
        latest = self._milestones.latest("psnr")
        if self._best is not None and latest is not None and self._best[0] > latest + 0.02:
            self._emit("decision", {"item": "kept state", "value": "best", "psnr": self._best[0], "last_psnr": latest})
            restore(trainer, self._generator, self._best[1])
        extraction = trainer.extract()
        surface = extraction.surface.detach()
        trainer.scene.follow(surface)
        trainer.inner_loop(surface, self._images, self.config.trainer.polish_steps, rate_factor=0.3)
        self.clock.stop()
        result = reconstruct(trainer.scene, surface, self.scene.box)
        self._report_end(result, status)
        return result

    # -- measuring and telling -----------------------------------------------------------------------------------

    def _report_if_due(self, progress: float) -> None:
        if self._milestones.due(progress, self.clock.train_seconds, self._evaluation_seconds):
            self._evaluate("time", progress)
            self._keep_good()
        now = time.monotonic()
        if self._snapshot_seconds is not None and now - self._last_snapshot >= self._snapshot_seconds:
            self._snapshot()
        if self._save is not None and now - self._last_checkpoint >= self.config.trainer.checkpoint_seconds:
            self.save_checkpoint()

    def _evaluate(self, reason: str, progress: float) -> None:
        """Measure the current surface on held-out views and against the reference; the clock stands still meanwhile."""
        began = time.monotonic()
        with self.clock.pause(), torch.no_grad():
            trainer = self._trainer
            extraction = trainer.extract()
            surface = extraction.surface.detach()
            row: dict[str, Any] = {"reason": reason, "progress": progress}
            row |= {"inner": trainer.inner_total, "faces": surface.faces.shape[0]}
            row |= {"gaussians": surface.faces.shape[0] * trainer.scene.binder.gaussians_per_face}
            row |= {"grid": max(extraction.grid.shape), "rss_mb": resident_megabytes()}
            row |= {"t_cpu_s": self.clock.cpu_seconds}
            trainer.scene.follow(surface)
            gaussians = object_gaussians(trainer.scene, surface)
            row |= image_measures(self._parts.rasterizer, gaussians, self._held_out, self.config.trainer.low_pass_px2)
            row |= mesh_measures(world_mesh(surface, self.scene.box)[0], self._reference, _CURVE_SAMPLES)
        self._milestones.add(progress, row)
        self._evaluation_seconds += time.monotonic() - began
        self._emit("evaluation", row)
        if row["psnr"] is not None and self._stage_index == len(self.config.trainer.stages) - 1:
            if self._best is None or row["psnr"] > self._best[0]:
                self._best = (row["psnr"], capture(trainer, self._stage_index, self._generator))

    def _report_end(self, result: Reconstruction, status: str) -> None:
        final = dict(self._milestones.rows[-1]) if self._milestones.rows else {}
        mesh = result.mesh
        if self._reference is not None and len(mesh.faces) > 0:
            final |= mesh_measures(mesh, MeasuredMesh(self._reference.mesh, _FINAL_SAMPLES), _FINAL_SAMPLES)
        final |= {"faces": len(mesh.faces), "gaussians": len(result.gaussians), "rss_mb": resident_megabytes()}
        self._final = {
            "status": status,
            "final": final,
            "certificate": asdict(certify(mesh.vertices, mesh.faces)),
            "milestones": self._milestones.shares(),
        }

    def announce_end(self, files: Mapping[str, str]) -> None:
        """Tell that the run is over and where its files are; the last event."""
        self._emit("run_ended", {**self._final, **files, "seconds": self.clock.wall_seconds})

    def _announce(self) -> None:
        box = self.scene.box
        self._emit(
            "run_started",
            {
                "method": self.config.method,
                "scene": self.scene.name,
                "notes": list(self.scene.notes),
                "total_steps": self._schedule.total_steps,
                "max_time": self.config.max_time,
                "views": len(self._views),
                "held_out": len(self._held_out),
                "box": [box.minimum.tolist(), box.maximum.tolist()],
                "device": str(self._parts.device),
                "rasterizer": type(self._parts.rasterizer).__name__,
                "seed": self.config.seed,
            },
        )

    def _emit(self, name: EventName, data: Mapping[str, Any]) -> None:
        self._emit_event(
            Event(
                t_train=self.clock.train_seconds,
                t_wall=self.clock.wall_seconds,
                outer=self.outer,
                event=name,
                data=data,
            )
        )

    def _snapshot(self) -> None:
        """The current surface in world frame, for whoever shows it."""
        with self.clock.pause(), torch.no_grad():
            extraction = self._trainer.extraction
            if extraction is not None:
                self._trainer.scene.follow(extraction.surface)
                self._emit("snapshot", {"reconstruction": self.current()})
        self._last_snapshot = time.monotonic()

    def current(self) -> Reconstruction:
        """The surface as of the latest extraction. Raises ValueError before the first."""
        if self._trainer.extraction is None:
            raise ValueError("there is no surface yet")
        return reconstruct(self._trainer.scene, self._trainer.extraction.surface.detach(), self.scene.box)

    # -- state ---------------------------------------------------------------------------------------------------

    def save_checkpoint(self) -> None:
        """Hand the whole state to whoever keeps it."""
        if self._save is None or self._trainer.seeds is None:
            return
        with self.clock.pause():
            progress = Progress(
                outer=self.outer,
                trained_seconds=self.clock.train_seconds,
                stage=self._stage_index,
                best_psnr=None if self._best is None else self._best[0],
                rate_scale=self._rate_scale,
                milestones=self._milestones.rows,
            )
            self._save(capture(self._trainer, self._stage_index, self._generator), progress)
            self._last_checkpoint = time.monotonic()
        self._emit("checkpoint", {"outer": self.outer})

    def _resume(self, state: Mapping[str, Tensor], progress: Progress) -> None:
        self.outer = progress.outer
        self._rate_scale = progress.rate_scale
        self._milestones = Milestones(progress.milestones)
        stage = self.config.trainer.stages[progress.stage]
        self._trainer.extractor.set_grid(self._parts.grid.at_level(stage.level))
        self._trainer.field.set_detail(self._trainer.extractor.grid.cell)
        restore(self._trainer, self._generator, state)
        self._stage_index = progress.stage
        self._load_images(stage)
        self.clock.stop()
        self.clock = TrainingClock(time.monotonic() - self.clock.wall_seconds, progress.trained_seconds)
        self.clock.start()
        self._keep_good()

    def _keep_good(self) -> None:
        self._last_good = capture(self._trainer, self._stage_index, self._generator)

    # -- small things --------------------------------------------------------------------------------------------

    def _deadline(self) -> float | None:
        """When optimisation must end for the mesh to be saved in time."""
        if self.config.max_time is None:
            return None
        reserve = max(4.0, 0.04 * self.config.max_time)
        return time.monotonic() - self.clock.wall_seconds + max(1.0, self.config.max_time - reserve)

    def _eta(self) -> float | None:
        progress = self._schedule.progress(self.outer)
        return None if progress <= 0 else self.clock.train_seconds * (1 - progress) / progress

    def _whole_image(self, view: View) -> TrainingImage:
        return prepare_image(view, self.scene.box, 1.0, self._parts.device, crop=False)

    def _in_object_frame(self, view: View) -> View:
        camera = self.scene.box.camera_to_object(view.camera)
        return View(name=view.name, camera=camera, rgb=view.rgb, alpha=view.alpha)
