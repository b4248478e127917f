"""A view beside what a run makes of it, for the report."""

import torch

from sculpt_framework.engine.images import TrainingImage
from sculpt_framework.evaluation.pictures import Picture, color_picture, difference_picture, normal_picture
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Gaussians


@torch.no_grad()
def view_pictures(
    rasterizer: Rasterizer, gaussians: Gaussians, image: TrainingImage, low_pass_px2: float
) -> dict[str, Picture]:
    """Reference, rendering, their difference and the normals, on white, under names for people."""
    white = torch.ones(3).to(image.premultiplied)
    rendering = rasterizer.render(gaussians, image.camera, white, low_pass_px2=low_pass_px2, normals=True)
    assert rendering.normal is not None, "normals were asked for"  # noqa: S101
    seen, made = image.over(white).rgb.cpu().numpy(), rendering.rgb.cpu().numpy()
    return {
        f"{image.name}: reference": color_picture(seen),
        "rendering": color_picture(made),
        "difference": difference_picture(made, seen),
        "normals, world frame": normal_picture(rendering.normal.cpu().numpy()),
    }
