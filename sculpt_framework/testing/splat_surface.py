"""How far the outline of a binder's Gaussians is from the outline of the mesh, on shapes of every kind."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from sculpt_framework.config import BinderConfig, ExtractorConfig
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.splat_outline import outline_offsets
from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.sculpting.gaussian_scene import assemble
from sculpt_framework.testing.extraction import box_sdf, sphere_sdf, torus_sdf
from sculpt_framework.types import Camera, Gaussians, Surface

_SAMPLES_ACROSS = 800
"""Samples of alpha along the side of an image, at the least."""
_CPU = torch.device("cpu")


def turned_sdf(sdf: SdfFunction) -> SdfFunction:
    """The same shape turned and moved by nothing round, so that its sides lie along no axis of a grid."""
    axis = torch.nn.functional.normalize(torch.tensor([0.3, 0.5, 0.81], dtype=torch.float64), dim=0)
    x, y, z = axis.tolist()
    cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
    turn = torch.matrix_exp(0.7 * cross)
    place = torch.tensor([0.013, -0.007, 0.019], dtype=torch.float64)

    def moved(points: Tensor) -> Tensor:
        return sdf((points - place.to(points)) @ turn.to(points))

    return moved


OUTLINE_SHAPES: Mapping[str, SdfFunction] = {
    "sphere": turned_sdf(sphere_sdf(0.7)),
    "cube": turned_sdf(box_sdf((0.5, 0.5, 0.5))),
    "torus": turned_sdf(torus_sdf(0.55, 0.22)),
    "plate": turned_sdf(box_sdf((0.7, 0.6, 0.05))),
}
"""In object units, inside the box of half side 1."""


def outline_cameras(pixels: int, views: int) -> list[Camera]:
    """Cameras of square images of ``pixels``, all round; the box of half side 1 fills seven tenths of them."""
    return [camera.to(_CPU, torch.float32) for camera in demo_cameras(views, pixels)]


def surface_on_grid(extractor: ExtractorConfig, sdf: SdfFunction, cells: int) -> Surface:
    """As extracted on a grid of ``cells`` along the sides of the box of half side 1."""
    grid = grid_over_box(torch.ones(3), cells=cells, level=0)
    with torch.no_grad():
        return extractor.build(grid, _CPU).extract(sdf, discover(sdf, grid, 0)).surface


def new_gaussians(binder: BinderConfig, surface: Surface, blur: float) -> Gaussians:
    """Black Gaussians as the binder's rows start with; ``blur`` as in ``Binder.bind``."""
    built = binder.build()
    vertices = surface.vertices
    rows = built.new_rows(len(surface.faces), vertices.device, vertices.dtype)
    binding = built.bind(surface, rows, blur=blur)
    return assemble(binding, binding.means.new_zeros((*binding.opacities.shape, 1, 3)))


def splat_surface_offsets(
    surface: Surface,
    binder: BinderConfig,
    rasterizer: Rasterizer,
    cameras: Sequence[Camera],
    *,
    low_pass_px2: float,
) -> Float64[np.ndarray, " n"]:
    """Signed offsets, in pixels, of the outlines in all views, as ``outline_offsets`` has them."""
    footprint = float(np.median([float(camera.world_to_camera[:3, 3].norm()) / camera.fx for camera in cameras]))
    gaussians = new_gaussians(binder, surface, math.sqrt(low_pass_px2) * footprint)
    mesh = Mesh(vertices=surface.vertices.detach().double().numpy(), faces=surface.faces.numpy())
    offsets = []
    for camera in cameras:
        finer = max(2, math.ceil(_SAMPLES_ACROSS / camera.width))
        offsets.append(outline_offsets(mesh, gaussians, camera, rasterizer, low_pass_px2=low_pass_px2, finer=finer))
    return np.concatenate(offsets)
