"""Fit a field to the surface a run starts from."""

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.extractors import SdfFunction
from sculpt_framework.fields import Field
from sculpt_framework.geometry.grid import Grid

_SAMPLES = 20_000
_TRUNCATION = 0.2
"""Distances beyond this, in object units, matter by their sign only."""


def tabulate(target: SdfFunction, grid: Grid, device: torch.device) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
    """Corners of the grid and the target there."""
    axes = [torch.arange(count + 1, device=device) for count in grid.shape]
    ijk = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3)
    points = grid.corner_positions(ijk, torch.float32)
    return points, torch.cat([target(chunk) for chunk in points.split(1 << 17)])


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

    The target is evaluated once, at the corners of ``grid``, which are the samples. Half of each batch lies within 2.5
    cells of the surface.
    """
    points, values = tabulate(target, grid, device)
    values = values.clamp(-_TRUNCATION, _TRUNCATION)
    near = (values.abs() < 2.5 * grid.cell).nonzero()[:, 0]
    if len(near) == 0:
        near = values.abs().topk(min(1000, len(values)), largest=False).indices
    groups = field.optimizer_groups()
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
    rates = [5.0 * group["lr"] for group in groups]
    error = float("nan")
    for step in range(steps):
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * 0.02 ** (step / max(1, steps - 1))
        anywhere = torch.randint(len(points), (_SAMPLES // 2,), generator=generator).to(device)
        close = near[torch.randint(len(near), (_SAMPLES // 2,), generator=generator).to(device)]
        chosen = torch.cat([anywhere, close])
        wanted = values[chosen]
        sdf = field(points[chosen]).sdf
        # Where the target is cut, the field may say anything beyond the cut of the right sign.
        residual = torch.where(
            wanted.abs() >= _TRUNCATION, (_TRUNCATION - sdf * wanted.sign()).clamp(min=0), (sdf - wanted).abs()
        )
        error = float(residual[_SAMPLES // 2 :].detach().mean())
        optimizer.zero_grad()
        residual.mean().backward()
        optimizer.step()
    return error
