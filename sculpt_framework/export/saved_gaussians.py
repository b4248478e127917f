"""How Gaussians look from cameras in world frame, on white: those of a run that goes on, and of a finished one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from sculpt_framework.config import MethodConfig, RasterizerConfig
from sculpt_framework.device import pick_device
from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.gaussian_files import read_gaussians_ply, write_gaussians_ply
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Box, Camera, Gaussians, Rendering, Scene

GAUSSIANS_NAME = "gaussians.ply"
BACKGROUND_NAME = "background.ply"
"""What is around the object, of a run that has learned it."""


@torch.no_grad()
def draw_gaussians(
    rasterizer: Rasterizer, gaussians: Gaussians, box: Box, camera: Camera, low_pass_px2: float, device: torch.device
) -> Rendering:
    """Of Gaussians in the object frame of ``box``."""
    local = box.camera_to_object(camera).to(device, torch.float32)
    return rasterizer.render(gaussians, local, torch.ones(3, device=device), low_pass_px2=low_pass_px2)


def draw_saved_gaussians(
    config: MethodConfig, rasterizer: RasterizerConfig, low_pass_px2: float, folder: Path, scene: Scene
) -> Callable[[Camera], Rendering]:
    """Of a finished run. Raises CheckpointError if the run has not left any."""
    device = pick_device(config.device)
    gaussians, built = saved_gaussians(folder, scene.box).to(device), rasterizer.build(device)
    return lambda camera: draw_gaussians(built, gaussians, scene.box, camera, low_pass_px2, device)


@torch.no_grad()
def save_gaussians(gaussians: Gaussians, box: Box, path: Path) -> Path:
    """Those in the object frame of ``box``, in world frame. Returns the path."""
    means = box.to_world(gaussians.means.double()).float()
    write_gaussians_ply(path, replace(gaussians, means=means, scales=gaussians.scales * box.scale))
    return path


def saved_gaussians(folder: Path, box: Box) -> Gaussians:
    """Those of a finished run, in the object frame of ``box``. Raises CheckpointError if it has not left any."""
    path = folder / GAUSSIANS_NAME
    if not path.is_file():
        raise CheckpointError(
            f"{folder} has no {GAUSSIANS_NAME}: the run has not finished; go on with --resume {folder}"
        )
    world = read_gaussians_ply(path)
    return replace(world, means=box.to_object(world.means.double()).float(), scales=world.scales / box.scale)
