"""Fit a field to the surface a run starts from."""

from collections.abc import Callable, Sequence

import torch

from sculpt_framework import registry
from sculpt_framework.config import ExtractorConfig
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.extractors import Extractor
from sculpt_framework.fields import Field
from sculpt_framework.geometry.band import discover
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.posed_images.training_images import in_object_frame
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.sculpting.supports import before_supports
from sculpt_framework.shape_from_images.field_fit import fit_field
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.types import Box, Support, Surface, View

_CELLS_AT_LEAST, _CELLS_AT_MOST = 64, 256
"""Along the longest side of the box, in which a start is tabulated; in between, as many as the finest stage has."""
_BLOCK = 2
"""Cells along a side of the blocks that are looked at first: a start may be half as steep again as a distance."""
_STEEPEST = 2.0
"""A start is only roughly a distance: its cells are searched as if it could be this steep."""


def fit_to_views(
    field: Field,
    initializer: Initializer,
    config: SculptingConfig,
    views: Sequence[View],
    box: Box,
    supports: Sequence[Support],
    detail: float,
    generator: torch.Generator,
    device: torch.device,
    come_by: Callable[[SdfFunction], None],
) -> float:
    """Fit the field to what the initializer makes of the views, as far as it lies before the ``supports``; returns as
    ``fit_field``. Views, box and supports are in world frame.

    ``detail`` is the size of the first stage's cells in object units, which the field is told.
    ``come_by`` is shown what the initializer makes, as it makes it. Raises DataError if no start can be made from the
    views.
    """
    cameras = [in_object_frame(view, box) for view in views]
    target = None
    for made in initializer.targets(cameras, box.half_sides, device):
        target = before_supports(made, supports, box)
        come_by(target)
    if target is None:
        raise ValueError(f"{type(initializer).__name__} makes nothing to start from")
    cells = min(max(config.trainer.finest_cells, _CELLS_AT_LEAST), _CELLS_AT_MOST)
    x, y, z = (float(side) for side in box.half_sides)
    volume = sample(target, (x, y, z), cells, device, block=_BLOCK)
    # Only the detail that the volume shows: finer levels would learn what happens between its centres, which is noise.
    field.set_detail(max(detail, volume.cell))
    error = fit_field(field, volume, steps=config.trainer.fit_steps, generator=generator, device=device)
    field.set_detail(detail)
    return error


def start_surface(target: SdfFunction, extractor: Extractor, device: torch.device) -> Surface:
    """What an initializer made, as a surface that no field has been fitted to. Raises EmptySurfaceError."""
    with torch.no_grad():
        seeds = discover(target, extractor.grid, coarse_level=0, lipschitz=_STEEPEST, device=device)
        return extractor.extract(target, seeds).surface


def start_mesh(target: SdfFunction, box: Box, cells: int) -> Mesh:
    """The same by marching tetrahedra in so many cells along the longest side of the box, in world frame."""
    device = torch.device("cpu")
    grid = grid_over_box(box.half_sides, cells)
    config = registry.default("extractor", "marching-tetrahedra")
    assert isinstance(config, ExtractorConfig)  # noqa: S101
    surface = start_surface(target, config.build(grid, device), device)
    return Mesh(vertices=box.to_world(surface.vertices.double()).numpy(), faces=surface.faces.numpy())
