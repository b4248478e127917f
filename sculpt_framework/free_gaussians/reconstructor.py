"""Free Gaussians as a session hosts them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.adam import Adam
from sculpt_framework.evaluation.extracted import world_mesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.saved_gaussians import GAUSSIANS_NAME, save_gaussians, saved_gaussians
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.free_gaussians.drawing import Lesson, colors_of_nearest, on_white
from sculpt_framework.free_gaussians.splats import Splats
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.losses import TrainingImage
from sculpt_framework.parameters import check_slopes, state_below
from sculpt_framework.posed_images.training_images import prepare_images
from sculpt_framework.reconstructor import Host, Moment, Reconstructor, StepReport
from sculpt_framework.types import Camera, Rendering, Scene

LAST_MEANS_RATE = 0.01
"""Of the means, the share that their learning rate ends at (3DGS, program)."""


class FreeGaussiansReconstructor(Reconstructor):
    """Gaussians in space, drawn, taught and made a mesh of as the config says."""

    begins_with_surface = False

    def __init__(self, config: FreeGaussiansConfig, scene: Scene, host: Host):
        self._config, self._box, self._host = config, scene.box, host
        self._device = config.pick_device()
        self._generator = torch.Generator().manual_seed(config.seed)
        self._drawing = config.build_drawing(self._device)
        self._grid = grid_over_box(scene.box.half_sides.float(), config.mesh_cells)
        self._mesher = config.build_mesher(self._grid, self._device)
        self._images: list[TrainingImage] = []
        self._order: list[int] = []
        """Views that are still to come before each has been looked at again."""
        half_sides = scene.box.half_sides.to(self._device)
        start = Splats.at_random(
            half_sides, config.gaussians, config.sh_degree, config.rates, self._generator, flat=config.flat
        )
        self._splats = start.owning(self._drawing.own_values(start.gaussians(1)), self._drawing.own_rates())
        self._shared = Adam(self._drawing.parameter_groups())
        """Of what is learned beside the Gaussians."""
        self._taken, self._progress = 0, 0.0
        """Steps taken, and the share of the run that was done when the last one was about to begin."""
        self._mesh: Mesh | None = None
        self._faces = 0
        """Of the mesh that was asked for last."""

    # -- learning ------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        return

    def settle(self, moment: Moment) -> None:
        before, self._progress = self._progress, moment.progress
        if least := self._config.least_opacity(before, moment.progress):
            self._splats, self._mesh = self._splats.without_clear(least), None

    @property
    def stage(self) -> int:
        return sum(self._progress >= share for share in self._config.stretches)

    @property
    def stages(self) -> int:
        return 1 + len(self._config.stretches)

    def step(self, moment: Moment) -> StepReport:
        config, splats, image = self._config, self._splats, self._next_image()
        background = torch.rand(3, generator=self._generator).to(self._device)
        lesson = Lesson(
            camera=image.camera,
            background=background,
            target=image.over(background),
            progress=moment.progress,
            generator=self._generator,
            own=splats.own,
        )
        terms = self._drawing.terms(splats.gaussians(self._bands), lesson)
        loss = torch.stack(list(terms.values())).sum()
        if not torch.isfinite(loss):
            raise FloatingPointError(f"the loss is {float(loss.detach())}")
        splats.zero_grad()
        self._shared.zero_grad()
        loss.backward()
        check_slopes(splats.parameters.items(), "Gaussians'")
        splats.note(image.camera)
        self._shared.step(moment.rate)
        splats.step(moment.rate, moment.rate * LAST_MEANS_RATE**moment.progress)
        self._taken += 1
        self._mesh = None
        self._splats = self._splats.after(self._taken, moment.progress, config.density, self._generator)
        told = {name: float(term.detach()) for name, term in terms.items()}
        facts = {"gaussians": len(self._splats)}
        return StepReport(loss=float(loss.detach()), terms=told, faces=self._faces, facts=facts)

    @property
    def _bands(self) -> int:
        return self._config.bands(self._taken)

    def _next_image(self) -> TrainingImage:
        if not self._images:
            self._images = prepare_images(self._host.views, self._box, 1.0, self._device)
            self._drawing.begin(self._images)
        if not self._order:
            self._order = torch.randperm(len(self._images), generator=self._generator).tolist()
        return self._images[self._order.pop()]

    # -- what can be seen of it ----------------------------------------------------------------------------------

    @torch.no_grad()
    def mesh(self) -> Mesh:
        if self._mesh is None:
            cameras = [
                self._box.camera_to_object(view.camera).to(self._device, torch.float32) for view in self._host.views
            ]
            surface = self._mesher.surface(self._drawing, self._splats.gaussians(1), cameras)
            self._mesh = world_mesh(surface, self._box)[0]
            self._faces = len(self._mesh.faces)
        return self._mesh

    @torch.no_grad()
    def colors(self) -> Float[np.ndarray, "v 3"]:
        return colors_of_nearest(self._splats.gaussians(1), self._box, self.mesh())

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        local = self._box.camera_to_object(camera).to(self._device, torch.float32)
        return on_white(self._drawing, self._splats.gaussians(self._bands), local)

    def sizes(self) -> Mapping[str, Any]:
        return {"faces": len(self.mesh().faces), "gaussians": len(self._splats), "grid": max(self._grid.shape)}

    @torch.no_grad()
    def save(self, folder: Path) -> dict[str, Path]:
        return {"gaussians": save_gaussians(self._splats.gaussians(self._bands), self._box, folder / GAUSSIANS_NAME)}

    # -- state ---------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Tensor]:
        own = {
            "taken": torch.tensor(self._taken),
            "progress": torch.tensor(self._progress, dtype=torch.float64),
            "order": torch.tensor(self._order, dtype=torch.int64),
            "random": self._generator.get_state(),
            "faces": torch.tensor(self._faces),
        }
        shared = {f"shared/{place}": value for place, value in enumerate(self._shared.parameters)}
        shared |= {f"shared_optimizer/{name}": value for name, value in self._shared.state().items()}
        every = self._splats.state() | shared | own
        return {name: value.detach().clone().contiguous() for name, value in every.items()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        self._taken, self._progress = int(state["taken"]), float(state["progress"])
        self._order = state["order"].tolist()
        self._generator.set_state(state["random"].clone())
        own = ("taken", "progress", "order", "random", "faces")
        splats = {name: value.to(self._device) for name, value in state.items() if name not in own and "/" not in name}
        self._splats = Splats.of_state(splats, self._config.rates, self._drawing.own_rates())
        with torch.no_grad():
            for place, parameter in enumerate(self._shared.parameters):
                parameter.copy_(state[f"shared/{place}"])
        self._shared.load_state(state_below(state, "shared_optimizer/"))
        self._mesh, self._faces = None, int(state["faces"])


def draw_saved(config: FreeGaussiansConfig, folder: Path, scene: Scene) -> Callable[[Camera], Rendering]:
    """Of a finished run. Raises CheckpointError if the run has not left any Gaussians."""
    device = config.pick_device()
    drawing, gaussians = config.build_drawing(device), saved_gaussians(folder, scene.box).to(device)
    return lambda camera: on_white(drawing, gaussians, scene.box.camera_to_object(camera).to(device, torch.float32))
