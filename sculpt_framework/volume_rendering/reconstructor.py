"""What methods that render a volume along rays do alike: learning, rendering, meshing, keeping their state."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from sculpt_framework.device import pick_device
from sculpt_framework.errors import CheckpointError, DataError
from sculpt_framework.evaluation.extracted import world_mesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.posed_images.training_images import prepare_images
from sculpt_framework.reconstructor import Host, Moment, Reconstructor, StepReport
from sculpt_framework.types import Box, Camera, Rendering, Scene, View
from sculpt_framework.volume_rendering.config import VolumeConfig
from sculpt_framework.volume_rendering.learner import VolumeLearner
from sculpt_framework.volume_rendering.occupancy import Occupancy
from sculpt_framework.volume_rendering.pixels import Pixels, rays_of
from sculpt_framework.volume_rendering.stretches import stretches_of
from sculpt_framework.volume_rendering.volume import Volume, look_along

Built = TypeVar("Built")

FILE_NAME = "volume.safetensors"
LEVEL = 2
"""Of the mesh's grid: cells four times as wide are looked at first."""
_RAYS_AT_ONCE, _POINTS_AT_ONCE = 1 << 14, 1 << 18


class VolumeReconstructor(Reconstructor):
    """Draws pixels at random and moves the volume's parameters by Adam until they look right."""

    begins_with_surface = False

    def __init__(self, config: VolumeConfig, scene: Scene, host: Host):
        """Raises DataError for images without masks."""
        require_masks(config.method, host.views)
        self._config, self._box, self._host = config, scene.box, host
        self._device = pick_device(config.device)
        volume = built_by_seed(config.build_volume, config.seed).to(self._device)
        generator = torch.Generator().manual_seed(config.seed)
        self._learner = VolumeLearner(volume, config.passing, scene.box.half_sides, generator)
        self._grid = grid_over_box(scene.box.half_sides.float(), config.mesh_cells >> LEVEL, LEVEL)
        self._pixels: Pixels | None = None
        self._mesh: Mesh | None = None
        self._faces = 0
        """Of the mesh that was asked for last."""

    # -- learning ------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        self._learner.look(afresh=True)

    def step(self, moment: Moment) -> StepReport:
        rate = moment.rate * self._config.final_rate**moment.progress
        lesson = self._learner.learn(self._training_pixels(), rate, moment.step)
        self._mesh = None
        return StepReport(loss=lesson.loss, terms=lesson.terms, faces=self._faces, facts=lesson.facts)

    def _training_pixels(self) -> Pixels:
        if self._pixels is None:
            self._pixels = Pixels(prepare_images(self._host.views, self._box, 1.0, self._device))
        return self._pixels

    # -- what can be seen of it ----------------------------------------------------------------------------------

    @torch.no_grad()
    def mesh(self) -> Mesh:
        if self._mesh is None:
            extractor = self._config.extractor.build(self._grid, self._device)
            level, seeds = self._learner.volume.surface(self._grid, self._learner.occupancy.cells)
            self._mesh = world_mesh(extractor.extract(level, seeds).surface, self._box)[0]
            self._faces = len(self._mesh.faces)
        return self._mesh

    @torch.no_grad()
    def colors(self) -> Float[np.ndarray, "v 3"]:
        """As seen along the normals."""
        mesh = self.mesh()
        normals = vertex_normals(mesh.vertices, mesh.faces)
        points = self._box.to_object(torch.from_numpy(mesh.vertices)).float().to(self._device)
        inward = torch.from_numpy(-normals).float().to(self._device)
        both = zip(points.split(_POINTS_AT_ONCE), inward.split(_POINTS_AT_ONCE), strict=True)
        return torch.cat([self._learner.volume.colors(*part) for part in both]).cpu().numpy()

    def render(self, camera: Camera) -> Rendering:
        learner, step = self._learner, self._config.passing.step
        return draw_volume(learner.volume, learner.occupancy, step, self._box, camera, self._device)

    def sizes(self) -> Mapping[str, Any]:
        return {"faces": len(self.mesh().faces), "grid": max(self._grid.shape)}

    # -- state ---------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Tensor]:
        return {**self._learner.state(), "faces": torch.tensor(self._faces)}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        self._learner.load_state(state)
        self._mesh, self._faces = None, int(state["faces"])

    def save(self, folder: Path) -> dict[str, Path]:
        kept = {"opacity": self._learner.occupancy.opacity, **self._learner.volume.state_dict()}
        path = folder / FILE_NAME
        write_atomically(path, save({name: value.cpu().contiguous() for name, value in kept.items()}))
        return {"volume": path}


@torch.no_grad()
def draw_volume(
    volume: Volume, occupancy: Occupancy, step: float, box: Box, camera: Camera, device: torch.device
) -> Rendering:
    """On white, from a camera in world frame; the volume is in the object frame of ``box``."""
    local = box.camera_to_object(camera).to(device, torch.float32)
    cells, parts = occupancy.cells, []
    for first in range(0, camera.width * camera.height, _RAYS_AT_ONCE):
        rays = rays_of(local, first, min(first + _RAYS_AT_ONCE, camera.width * camera.height))
        parts.append(look_along(volume, rays, stretches_of(rays, cells, step)))
    alpha = torch.cat([part.alpha for part in parts])
    rgb = torch.cat([part.rgb for part in parts]) + (1 - alpha)[:, None]
    # Of distances along rays, the camera's own z.
    every = rays_of(local, 0, camera.width * camera.height)
    ahead = every.directions @ local.world_to_camera[2, :3]
    shape = (camera.height, camera.width)
    depth = torch.cat([part.depth for part in parts]) * ahead
    return Rendering(rgb=rgb.reshape(*shape, 3), alpha=alpha.reshape(shape), depth=depth.reshape(shape))


def draw_saved_volume(config: VolumeConfig, folder: Path, scene: Scene) -> Callable[[Camera], Rendering]:
    """Of a finished run. Raises CheckpointError if the run has not left its volume."""
    path, device = folder / FILE_NAME, pick_device(config.device)
    volume, occupancy = built_by_seed(config.build_volume, config.seed), occupancy_of(config.cells, scene.box, device)
    try:
        kept = load_file(path)
        occupancy.opacity = kept.pop("opacity").to(device)
        volume.load_state_dict(kept)
    except (OSError, KeyError, RuntimeError, SafetensorError) as error:
        raise CheckpointError(
            f"{path} is not there, or not of this config ({type(error).__name__}). If the run has not finished, go on "
            f"with --resume {folder}"
        ) from error
    volume, step = volume.to(device), config.passing.step
    return lambda camera: draw_volume(volume, occupancy, step, scene.box, camera, device)


def built_by_seed(build: Callable[[], Built], seed: int) -> Built:
    """What is random in it follows the seed; the numbers of whoever calls stay what they would be."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return build()


def require_masks(method: str, views: Sequence[View]) -> None:
    """Raises DataError for images without masks."""
    if missing := [view.name for view in views if view.alpha is None]:
        raise DataError(
            f"{method} learns from images with masks, and {len(missing)} of {len(views)} have none, {missing[0]} among "
            "them. Add masks, or use gaussian-sculpting."
        )


def occupancy_of(cells: int, box: Box, device: torch.device) -> Occupancy:
    """All of the box occupied."""
    return Occupancy(box.half_sides.float(), cells, device)
