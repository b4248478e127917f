"""A view's photograph beside what the Gaussians look like from there."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import UInt8

from sculpt_framework import registry
from sculpt_framework.config import RasterizerConfig
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Gaussians, Scene
from sculpt_framework.viewing.layers import as_bytes

_PIXELS_AT_MOST = 480
"""Longest side: these pictures go into a side panel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Three pictures of one size, over white."""

    photograph: UInt8[np.ndarray, "h w 3"]
    rendering: UInt8[np.ndarray, "h w 3"]
    difference: UInt8[np.ndarray, "h w 3"]
    """Absolute, per channel, four times as strong; over white nothing differs: black."""


def rasterizer_here() -> Rasterizer:
    """On the CPU, whatever the run uses: an accelerator is the run's."""
    config = registry.default("rasterizer", "auto")
    assert isinstance(config, RasterizerConfig)  # noqa: S101
    return config.build(torch.device("cpu"))


@torch.no_grad()
def compare(rasterizer: Rasterizer, low_pass_px2: float, scene: Scene, index: int, gaussians: Gaussians) -> Comparison:
    """Render a train view's camera; ``gaussians`` are in world frame."""
    view, box = scene.train[index], scene.box
    scale = min(1.0, _PIXELS_AT_MOST / max(view.camera.width, view.camera.height))
    image = prepare_image(view, box, scale, torch.device("cpu"), crop=False)
    local = replace(gaussians, means=box.to_object(gaussians.means), scales=gaussians.scales / box.scale)
    white = torch.ones(3)
    rendering = rasterizer.render(local, image.camera, white, low_pass_px2=low_pass_px2, normals=False)
    target = image.over(white).rgb
    return Comparison(
        photograph=as_bytes(target.numpy()),
        rendering=as_bytes(rendering.rgb.numpy()),
        difference=as_bytes(4 * (rendering.rgb - target).abs().numpy()),
    )
