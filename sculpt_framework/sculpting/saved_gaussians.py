"""The Gaussians of a finished run, to be looked at."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from sculpt_framework.device import pick_device
from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.gaussian_files import read_gaussians_ply
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.types import Camera, Rendering, Scene


def draw_saved_gaussians(config: SculptingConfig, folder: Path, scene: Scene) -> Callable[[Camera], Rendering]:
    """How they look from cameras in world frame, on white. Raises CheckpointError if the run has not left any."""
    path = folder / "gaussians.ply"
    if not path.is_file():
        raise CheckpointError(f"{folder} has no gaussians.ply: the run has not finished; go on with --resume {folder}")
    world, box = read_gaussians_ply(path), scene.box
    gaussians = replace(world, means=box.to_object(world.means.double()).float(), scales=world.scales / box.scale)
    device = pick_device(config.device)
    rasterizer, low_pass = config.rasterizer.build(device), config.trainer.low_pass_px2

    @torch.no_grad()
    def render(camera: Camera) -> Rendering:
        local = box.camera_to_object(camera).to(device, torch.float32)
        return rasterizer.render(gaussians, local, torch.ones(3, device=device), low_pass_px2=low_pass)

    return render
