"""Gaussians beside a field as a session hosts them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.adam import Adam
from sculpt_framework.evaluation.extracted import world_mesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.saved_gaussians import GAUSSIANS_NAME, save_gaussians
from sculpt_framework.free_gaussians.drawing import Lesson, Terms, colors_of_nearest, on_white
from sculpt_framework.free_gaussians.reconstructor import LAST_MEANS_RATE
from sculpt_framework.free_gaussians.splats import Splats
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.guided_gaussians.config import GuidedGaussiansConfig
from sculpt_framework.guided_gaussians.guide import RayLesson, Shown
from sculpt_framework.losses import TrainingImage
from sculpt_framework.parameters import check_slopes, state_below
from sculpt_framework.posed_images.training_images import prepare_images
from sculpt_framework.reconstructor import Host, Moment, Reconstructor, StepReport
from sculpt_framework.types import Camera, Gaussians, Rendering, Scene
from sculpt_framework.volume_rendering.learner import LOOK_EVERY
from sculpt_framework.volume_rendering.pixels import rays_at
from sculpt_framework.volume_rendering.reconstructor import LEVEL, built_by_seed, occupancy_of, require_masks

_OWN = ("taken", "progress", "order", "random", "faces", "opacity")


class GuidedGaussiansReconstructor(Reconstructor):
    """One view a step: the Gaussians are drawn, rays through some of its pixels pass the field, and the guide says what
    each learns of the other."""

    begins_with_surface = False

    def __init__(self, config: GuidedGaussiansConfig, scene: Scene, host: Host):
        """Raises DataError for images without masks."""
        require_masks(config.method, host.views)
        self._config, self._box, self._host = config, scene.box, host
        self._device = config.pick_device()
        self._generator = torch.Generator().manual_seed(config.seed)
        self._drawing = config.build_drawing(self._device)
        self._guide = built_by_seed(config.build_guide, config.seed).to(self._device)
        self._optimizer = Adam(list(self._guide.parameter_groups()), betas=(0.9, 0.99))
        self._occupancy = occupancy_of(config.rays.cells, scene.box, self._device)
        self._grid = grid_over_box(scene.box.half_sides.float(), config.mesh_cells >> LEVEL, LEVEL)
        self._step = 2.0 / config.rays.steps_across
        self._images: list[TrainingImage] = []
        self._order: list[int] = []
        """Views that are still to come before each has been looked at again."""
        half_sides = scene.box.half_sides.to(self._device)
        self._splats = Splats.at_random(half_sides, config.gaussians, config.sh_degree, config.rates, self._generator)
        self._taken, self._progress = 0, 0.0
        """Steps taken, and the share of the run that was done when the last one was about to begin."""
        self._mesh: Mesh | None = None
        self._faces = 0
        """Of the mesh that was asked for last."""

    # -- learning ------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        self._look(afresh=True)

    def settle(self, moment: Moment) -> None:
        self._progress = moment.progress

    @property
    def stage(self) -> int:
        return sum(self._progress >= share for share in self._config.stretches)

    @property
    def stages(self) -> int:
        return 1 + len(self._config.stretches)

    @property
    def _joint(self) -> bool:
        """Whether the field learns."""
        return self._progress >= self._config.alone_until

    def step(self, moment: Moment) -> StepReport:
        config, splats, image = self._config, self._splats, self._next_image()
        background = torch.rand(3, generator=self._generator).to(self._device)
        lesson = Lesson(
            camera=image.camera,
            background=background,
            target=image.over(background),
            progress=moment.progress,
            generator=self._generator,
        )
        drawn = self._drawing.draw(self._gaussians(self._bands), image.camera, background)
        terms: Terms = self._drawing.color_terms(drawn, lesson)
        if self._joint:
            terms |= self._guide.terms(self._ray_lesson(image, drawn, background))
        loss = torch.stack(list(terms.values())).sum()
        if not torch.isfinite(loss):
            raise FloatingPointError(f"the loss is {float(loss.detach())}")
        splats.zero_grad()
        self._optimizer.zero_grad()
        loss.backward()
        check_slopes(splats.parameters.items(), "Gaussians'")
        check_slopes(self._guide.named_parameters(), "field's")
        splats.note(image.camera)
        splats.step(moment.rate, moment.rate * LAST_MEANS_RATE**moment.progress)
        self._optimizer.step(moment.rate * config.rays.final_rate**moment.progress)
        self._taken += 1
        self._mesh = None
        if self._joint and self._taken % LOOK_EVERY == 0:
            self._look()
        worth = self._guide.worth if self._joint else None
        self._splats = splats.after(self._taken, moment.progress, config.density, self._generator, worth)
        told = {name: float(term.detach()) for name, term in terms.items()}
        facts = {"gaussians": len(self._splats), **self._guide.facts()}
        return StepReport(loss=float(loss.detach()), terms=told, faces=self._faces, facts=facts)

    def _gaussians(self, bands: int) -> Gaussians:
        return self._guide.guided(self._splats.gaussians(bands))

    def _ray_lesson(self, image: TrainingImage, drawn: Rendering, background: Float[Tensor, " 3"]) -> RayLesson:
        camera, alpha = image.camera, image.alpha
        assert alpha is not None  # noqa: S101
        assert drawn.normal is not None  # noqa: S101
        count = camera.width * camera.height
        # None twice: what the drawing learns from one pixel would be added up in whatever order threads come.
        number = torch.randperm(count, generator=self._generator)[: self._config.rays.number].to(self._device)
        rays = rays_at(camera, number)
        # Of the camera's own z, distances along rays.
        ahead = rays.directions @ camera.world_to_camera[2, :3]
        shown = Shown(
            rays=rays,
            alpha=drawn.alpha.reshape(-1)[number],
            depth=drawn.depth.reshape(-1)[number] / ahead,
            normal=drawn.normal.reshape(-1, 3)[number],
        )
        return RayLesson(
            shown=shown,
            premultiplied=image.premultiplied.reshape(-1, 3)[number],
            alpha=alpha.reshape(-1)[number],
            background=background,
            cells=self._occupancy.cells,
            generator=self._generator,
        )

    @property
    def _bands(self) -> int:
        return self._config.bands(self._taken)

    def _next_image(self) -> TrainingImage:
        if not self._images:
            self._images = prepare_images(self._host.views, self._box, 1.0, self._device)
        if not self._order:
            self._order = torch.randperm(len(self._images), generator=self._generator).tolist()
        return self._images[self._order.pop()]

    def _look(self, *, afresh: bool = False) -> None:
        volume = self._guide.volume
        self._occupancy.look(
            lambda points, radius: volume.most_opaque(points, radius, self._step), self._generator, afresh=afresh
        )

    # -- what can be seen of it ----------------------------------------------------------------------------------

    @torch.no_grad()
    def mesh(self) -> Mesh:
        """The field's zero."""
        if self._mesh is None:
            extractor = self._config.extractor.build(self._grid, self._device)
            level, seeds = self._guide.volume.surface(self._grid, self._occupancy.cells)
            self._mesh = world_mesh(extractor.extract(level, seeds).surface, self._box)[0]
            self._faces = len(self._mesh.faces)
        return self._mesh

    @torch.no_grad()
    def colors(self) -> Float[np.ndarray, "v 3"]:
        return colors_of_nearest(self._splats.gaussians(1), self._box, self.mesh())

    @torch.no_grad()
    def render(self, camera: Camera) -> Rendering:
        """The Gaussians."""
        local = self._box.camera_to_object(camera).to(self._device, torch.float32)
        return on_white(self._drawing, self._gaussians(self._bands), local)

    def sizes(self) -> Mapping[str, Any]:
        return {"faces": len(self.mesh().faces), "gaussians": len(self._splats), "grid": max(self._grid.shape)}

    @torch.no_grad()
    def save(self, folder: Path) -> dict[str, Path]:
        return {"gaussians": save_gaussians(self._gaussians(self._bands), self._box, folder / GAUSSIANS_NAME)}

    # -- state ---------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Tensor]:
        guide = {f"guide/{name}": value for name, value in self._guide.state_dict().items()}
        optimizer = {f"guide_optimizer/{name}": value for name, value in self._optimizer.state().items()}
        own = {
            "taken": torch.tensor(self._taken),
            "progress": torch.tensor(self._progress, dtype=torch.float64),
            "order": torch.tensor(self._order, dtype=torch.int64),
            "random": self._generator.get_state(),
            "faces": torch.tensor(self._faces),
            "opacity": self._occupancy.opacity,
        }
        every = self._splats.state() | guide | optimizer | own
        return {name: value.detach().clone().contiguous() for name, value in every.items()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        guide = state_below(state, "guide/")
        # An earlier version's has colours also where rays bring none.
        self._guide.load_state_dict({name: guide[name] for name in self._guide.state_dict()})
        self._optimizer.load_state(state_below(state, "guide_optimizer/"))
        splats = {name: value.to(self._device) for name, value in state.items() if name not in _OWN and "/" not in name}
        self._splats = Splats.of_state(splats, self._config.rates)
        self._taken, self._order = int(state["taken"]), state["order"].tolist()
        # An earlier version's has none; the next step begins with settling.
        self._progress = float(state.get("progress", 0.0))
        self._generator.set_state(state["random"].clone())
        self._occupancy.opacity = state["opacity"].to(self._device).clone()
        self._mesh, self._faces = None, int(state["faces"])
