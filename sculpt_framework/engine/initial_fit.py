"""Fit a field to the surface a run starts from."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from sculpt_framework.adam import Adam
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.images import in_object_frame
from sculpt_framework.extractors import SdfFunction
from sculpt_framework.fields import Field
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.types import Box, View

_INITIAL_CELLS = 64
"""Cells along the longest side at which the initial surface is tabulated."""
_SAMPLES = 20_000
_TRUNCATION = 0.2
"""Distances beyond this, in object units, matter by their sign only."""


def fit_to_views(
    field: Field,
    config: MethodConfig,
    views: Sequence[View],
    box: Box,
    grid: Grid,
    detail: float,
    generator: torch.Generator,
    device: torch.device,
) -> float:
    """Fit the field to what the method's initializer makes of the views, in world frame; returns as ``fit_field``.

    ``grid`` is at level 0, ``detail`` the size of the first stage's cells in object units, which the field is told.
    Raises DataError if no start can be made from the views.
    """
    cameras = [in_object_frame(view, box) for view in views]
    target = config.initializer.build().target(cameras, box.half_sides, device)
    level = 0
    while config.trainer.base_cells << (level + 1) <= _INITIAL_CELLS:
        level += 1
    fine = grid.at_level(level)
    # Only the detail that the table shows: finer levels would learn what happens between its corners, which is noise.
    field.set_detail(max(detail, fine.cell))
    error = fit_field(field, target, fine, steps=config.trainer.fit_steps, generator=generator, device=device)
    field.set_detail(detail)
    return error


def tabulate(target: SdfFunction, grid: Grid, device: torch.device) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Corners of the grid and the target there."""
    axes = [torch.arange(count + 1, device=device) for count in grid.shape]
    ijk = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3)
    points = grid.corner_positions(ijk, torch.float32)
    return points, torch.cat([target(chunk) for chunk in points.split(1 << 17)])


def interpolate(values: Float[Tensor, " m"], grid: Grid, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
    """Trilinear interpolation of values at the grid's corners; points outside take the nearest wall's."""
    x, y, z = grid.shape
    volume = values.reshape(1, 1, x + 1, y + 1, z + 1)
    origin = torch.tensor(grid.origin, device=points.device, dtype=points.dtype)
    shape = torch.tensor(grid.shape, device=points.device, dtype=points.dtype)
    unit = 2 * (points - origin) / (grid.cell * shape) - 1
    # grid_sample wants coordinates in the reverse order of the volume's axes.
    where = unit.flip(1)[None, None, None]
    return functional.grid_sample(volume, where, mode="bilinear", padding_mode="border", align_corners=True)[0, 0, 0, 0]


def fit_field(
    field: Field,
    target: SdfFunction,
    grid: Grid,
    *,
    steps: int,
    generator: torch.Generator,
    device: torch.device,
) -> float:
    """Regress the field to the target by Adam; returns the mean absolute error near the surface, in object units.

    The target is evaluated once, at the corners of ``grid``, and interpolated from there at random points, so that a
    field finer than the grid has no corner left untouched. Half of each batch lies within 2.5 cells of the surface.
    """
    points, values = tabulate(target, grid, device)
    values = values.clamp(-_TRUNCATION, _TRUNCATION)
    near = (values.abs() < 2.5 * grid.cell).nonzero()[:, 0]
    if len(near) == 0:
        near = values.abs().topk(min(1000, len(values)), largest=False).indices
    groups = field.parameter_groups()
    optimizer = Adam([(group.parameters, group.fit_rate) for group in groups], betas=(0.9, 0.99))
    half = _SAMPLES // 2
    error = float("nan")
    for step in range(steps):
        anywhere = torch.randint(len(points), (half,), generator=generator).to(device)
        close = near[torch.randint(len(near), (half,), generator=generator).to(device)]
        jitter = (torch.rand(2 * half, 3, generator=generator) - 0.5).to(points) * grid.cell
        where = points[torch.cat([anywhere, close])] + jitter
        wanted = interpolate(values, grid, where)
        sdf = field(where).sdf
        # Where the target is cut, the field may say anything beyond the cut of the right sign.
        cut = wanted.abs() >= 0.999 * _TRUNCATION
        residual = torch.where(cut, (_TRUNCATION - sdf * wanted.sign()).clamp(min=0), (sdf - wanted).abs())
        error = float(residual[half:].detach().mean())
        optimizer.zero_grad()
        residual.mean().backward()
        optimizer.step(0.02 ** (step / max(1, steps - 1)))
    return error
