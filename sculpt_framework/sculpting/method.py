"""The bi-level method as a session hosts it (paper, 3)."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.commands import Command
from sculpt_framework.evaluation.extracted import world_mesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.gaussian_files import write_gaussians_ply
from sculpt_framework.export.saved_gaussians import BACKGROUND_NAME, GAUSSIANS_NAME, draw_gaussians, save_gaussians
from sculpt_framework.extractors import Extractor
from sculpt_framework.geometry.signed_distance import EmptySurfaceError, SdfFunction
from sculpt_framework.losses import TrainingImage
from sculpt_framework.parallel.processes import Alone
from sculpt_framework.posed_images.training_images import pixel_footprint, prepare_images
from sculpt_framework.reconstructor import Host, Moment, Reconstructor, StepReport
from sculpt_framework.sculpting import assembly, memory_check
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig
from sculpt_framework.sculpting.initial_fit import fit_to_views, start_surface
from sculpt_framework.sculpting.polish import polish
from sculpt_framework.sculpting.rates import Rates
from sculpt_framework.sculpting.reconstruction import Reconstruction, object_gaussians, reconstruct
from sculpt_framework.sculpting.sh_pruning import Judge, prune_bands
from sculpt_framework.sculpting.silhouettes_first import shape_by_silhouettes
from sculpt_framework.sculpting.state import capture, restore, undisturbed
from sculpt_framework.sculpting.steering import Wishes
from sculpt_framework.sculpting.supports import before_supports
from sculpt_framework.sculpting.trainer import Settled
from sculpt_framework.snapshot import Cells, Snapshot
from sculpt_framework.types import Camera, Gaussians, Rendering, Scene, Surface

_TIME_FOR_SILHOUETTES = 0.4
"""Of a time limit, at most."""


class Sculpting(Reconstructor):
    """An SDF whose surface is extracted anew in each step, with Gaussians on its faces that learn colours between."""

    def __init__(self, config: SculptingConfig, scene: Scene, host: Host):
        """Raises SculptError for what the components cannot do together."""
        self.config = config
        self._box, self._supports, self._points, self._host = scene.box, scene.supports, scene.points, host
        self._generator = torch.Generator().manual_seed(config.seed)
        parts = assembly.build_parts(config, scene.box, self._generator, host.processes)
        self.trainer = parts.trainer
        self.trainer.signed_distance = before_supports(self.trainer.signed_distance, scene.supports, scene.box)
        self._rates = Rates(config.trainer, timed=host.timed)
        self.images: list[TrainingImage] = []
        """What the present stage learns from."""
        self._stage, self._told = -1, False
        self._settled: Settled | None = None
        self._gaussians: Gaussians | None = None
        """In the object frame, of the latest extraction, once they have been asked for."""
        self._result: Reconstruction | None = None
        """Of the latest extraction, in world frame, once it has been asked for."""
        self._finished = False
        self._wishes = Wishes(parts, config, scene.box)

    @property
    def parts(self) -> assembly.Parts:
        """The components, refined as has been asked for."""
        return self._wishes.parts

    # -- a run ---------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Fit the field to the initial surface and find the cells it passes through."""
        config, parts, host, box = self.config, self.parts, self._host, self._box
        random, device, initializer = self._generator, parts.device, config.initializer.build()
        error = fit_to_views(
            self.trainer.field,
            initializer,
            config,
            host.views,
            box,
            self._supports,
            parts.detail,
            random,
            device,
            self._show_start,
        )
        if (background := self.trainer.background) is not None:
            background.begin(host.views, box, self._points, self._generator)
        self.trainer.equalize()
        name = type(config.initializer).__name__.removesuffix("Config")
        host.tell("decision", {"item": "initial surface", "value": name, "fit_error": error, **initializer.findings})
        end = host.deadline(share_left=1 - _TIME_FOR_SILHOUETTES, seconds_left=3.0)
        for told in shape_by_silhouettes(parts, config, host.views, box, end):
            host.tell("decision", told)
        self._enter(self._rates.stage_index(host.progress()))

    def settle(self, moment: Moment) -> None:
        index = self._rates.stage_index(moment.progress)
        if index != self._stage and not moment.last:
            self._enter(index)
        elif not self._told:  # A saved run is resumed.
            self._require_images()
            self._tell_stage()
        rate = self._rates.factor(moment.progress) * moment.rate
        self._forget_shown()
        self._settled = self.trainer.settle(self.images, self._stage_config, rate, self._warm)

    def step(self, moment: Moment) -> StepReport:
        assert self._settled is not None, "a step begins with settling"  # noqa: S101
        settled, self._settled = self._settled, None
        factor = self._rates.factor(moment.progress) * moment.rate
        rate = self._rates.surface(factor, moment.step, moment.progress)
        report = self.trainer.update(settled, self.images, self._stage_config, rate)
        self._forget_shown()
        bands = prune_bands(self.trainer, settled.binding, self.judge, self.config.trainer, moment.step + 1)
        return StepReport(
            loss=report.loss,
            terms=report.terms,
            faces=report.faces,
            facts={
                "inner_loss": report.inner_loss,
                "inner_s": report.inner_seconds,
                "gaussians": report.gaussians,
                "step_kept": report.step_kept,
            },
            decisions=[*self.trainer.gating.news(), *bands],
        )

    def finish(self) -> None:
        """Colours on the final surface, for as many steps as the method says and the time limit allows."""
        self._settled = None
        self._require_images()
        surface = self._follow()
        kept, scene = capture(self.trainer, self._stage, self._generator), self.trainer.scene
        binder, wanted = scene.binder, self.config.trainer.polish_gaussians
        end = self._host.deadline(share_left=0.025, seconds_left=2.0)
        more = binder.with_gaussians(max(wanted, binder.gaussians_per_face))
        if more.gaussians_per_face > binder.gaussians_per_face:
            scene.rebind(more)
        try:
            trainer = self.config.trainer
            for told in polish(self.trainer, surface, self.images, self.judge, trainer, end):
                self._host.tell("decision", told)
        except FloatingPointError as error:
            self._host.warn(f"colours are as training left them: {error}")
            scene.binder = binder
            self.load_state(kept)
            self._follow()
        self._forget_shown()
        self._finished = True

    @property
    def stage(self) -> int:
        return self._stage

    @property
    def stages(self) -> int:
        return len(self.config.trainer.stages)

    @property
    def _stage_config(self) -> StageConfig:
        return self.config.trainer.stages[self._stage]

    def _enter(self, index: int) -> None:
        stage = self.config.trainer.stages[index]
        assembly.set_level(self.parts, stage.level)
        if self.trainer.seeds is None:
            assembly.find_seeds(self.parts)
        self._load_images(index)
        self.trainer.begin_stage()
        self._stage = index
        self._tell_stage()

    def _load_images(self, index: int) -> None:
        stage, views, box = self.config.trainer.stages[index], self._host.views, self._box
        memory_check.check_memory(self.trainer, views, box, stage, index, self._host.warn)
        background = self.trainer.background
        around = None if background is None else background.around
        self.images = prepare_images(views, box, stage.image_scale, self.parts.device, around=around)
        assembly.take_images(self.trainer, self.config.trainer, self.images)
        self.trainer.scene.blur = math.sqrt(self.config.trainer.low_pass_px2) * pixel_footprint(self.images)

    def _require_images(self) -> None:
        """A saved run has none to begin with. Raises TrainingFailed where memory does not suffice for them."""
        if not self.images:
            self._load_images(self._stage)

    def _tell_stage(self) -> None:
        stage, self._told = self._stage_config, True
        self._host.tell(
            "stage",
            {
                "index": self._stage,
                "count": self.stages,
                "level": stage.level,
                "grid": list(self.trainer.extractor.grid.shape),
                "image_scale": stage.image_scale,
                "inner_steps": stage.inner_steps,
                "silhouette_only": stage.silhouette_only,
            },
        )

    def _warm(self) -> bool:
        return self._rates.warm(self._host.progress())

    def _show_start(self, target: SdfFunction) -> None:
        extractor = self.config.extractor.build(self.trainer.extractor.grid, self.parts.device)
        self._host.show_start(lambda: self._start_mesh(target, extractor))

    def _start_mesh(self, target: SdfFunction, extractor: Extractor) -> tuple[Mesh, Mapping[str, Any]] | None:
        try:
            surface = start_surface(target, extractor, self.parts.device)
        except EmptySurfaceError:
            return None
        sizes = {"inner": 0, "faces": surface.faces.shape[0], "gaussians": 0, "grid": max(extractor.grid.shape)}
        return world_mesh(surface, self._box)[0], sizes

    # -- state ---------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Tensor]:
        return capture(self.trainer, self._stage, self._generator)

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Of whatever stage. If that is not the one the present progress is in, the next step enters that again."""
        index = int(state["stage"])
        self.trainer.extractor.set_grid(self.parts.grid.at_level(self.config.trainer.stages[index].level))
        self.trainer.field.set_detail(self.parts.detail)
        restore(self.trainer, self._generator, state)
        assembly.fit_seeds(self.parts)
        self._settled, self._stage = None, index
        self._forget_shown()

    def alone(self) -> None:
        self.trainer.processes = Alone()

    # -- what can be seen of it ----------------------------------------------------------------------------------

    def mesh(self) -> Mesh:
        if self._result is not None:
            return self._result.mesh
        with self._shown() as surface:
            return world_mesh(surface, self._box)[0]

    def colors(self) -> Float[np.ndarray, "v 3"]:
        return self.reconstruction().colors

    def reconstruction(self) -> Reconstruction:
        """Mesh, colours and Gaussians, in world frame."""
        if self._result is None:
            with self._shown() as surface:
                self._result = reconstruct(self.trainer.scene, surface, self._box)
        return self._result

    def render(self, camera: Camera) -> Rendering:
        """The Gaussians."""
        if self._gaussians is None:
            with self._shown() as surface:
                self._gaussians = object_gaussians(self.trainer.scene, surface)
        return self._draw(self._gaussians, camera)

    def sizes(self) -> Mapping[str, Any]:
        trainer = self.trainer
        if self._finished:
            # Of what is saved: stray pieces are left out.
            result = self.reconstruction()
            faces, gaussians = len(result.faces), len(result.gaussians)
        else:
            with self._shown() as surface:
                faces = surface.faces.shape[0]
            gaussians = faces * trainer.scene.binder.gaussians_per_face
        grid = max(trainer.extractor.grid.shape)
        return {"inner": trainer.inner_total, "faces": faces, "gaussians": gaussians, "grid": grid}

    def about(self) -> Mapping[str, Any]:
        return {"rasterizer": type(self.parts.rasterizer).__name__}

    def save(self, folder: Path) -> dict[str, Path]:
        path = folder / GAUSSIANS_NAME
        write_gaussians_ply(path, self.reconstruction().gaussians)
        if self.trainer.background is None:
            return {"gaussians": path}
        behind = save_gaussians(self.trainer.background.gaussians(), self._box, folder / BACKGROUND_NAME)
        return {"gaussians": path, "background": behind}

    @torch.no_grad()
    def snapshot(self) -> Snapshot | None:
        if self.trainer.seeds is None:
            return None
        with self._shown() as surface:
            extraction = self.trainer.extraction
            assert extraction is not None, "it is what is shown"  # noqa: S101
            gaussians = object_gaussians(self.trainer.scene, surface)
            cells = Cells(grid=extraction.grid, keys=extraction.cells)
            return Snapshot(surface=surface, box=self._box, gaussians=gaussians, cells=cells)

    def obey(self, command: Command, step: int, folder: Path) -> str:
        return self._wishes.obey(command, step, folder)

    def _draw(self, gaussians: Gaussians, camera: Camera) -> Rendering:
        """Gaussians of the object frame, a camera in world frame."""
        low_pass, device = self.config.trainer.low_pass_px2, self.parts.device
        return draw_gaussians(self.parts.rasterizer, gaussians, self._box, camera, low_pass, device)

    @property
    def judge(self) -> Judge | None:
        """How good held-out views are with these Gaussians; None where nobody measures."""
        if not self._host.judged:
            return None
        return lambda gaussians: self._host.judge(lambda camera: self._draw(gaussians, camera).rgb)

    def _follow(self) -> Surface:
        """The current surface without gradient, with the Gaussians' rows on it from here on."""
        surface = self.trainer.extract().surface.detach()
        self.trainer.scene.follow(surface)
        self._forget_shown()
        return surface

    @contextmanager
    def _shown(self) -> Iterator[Surface]:
        """The latest surface, which the Gaussians are on. Where there is none, one is extracted for a look: the next
        step is what it would have been."""
        if self.trainer.extraction is not None:
            yield self.trainer.extraction.surface.detach()
            return
        # They say how large cells are, and pixels.
        self._require_images()
        with undisturbed(self.trainer), torch.no_grad():
            surface = self.trainer.extract().surface.detach()
            self.trainer.scene.follow(surface)
            yield surface

    def _forget_shown(self) -> None:
        self._gaussians = self._result = None
