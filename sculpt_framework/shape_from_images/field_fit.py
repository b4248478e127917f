"""Fit a field to a tabulated surface."""

import torch

from sculpt_framework.adam import Adam
from sculpt_framework.fields import Field
from sculpt_framework.shape_from_images.volume import Volume

SAMPLES, _NEAR_SHARE, _NEAR_CELLS = 20_000, 0.8, 1.5
"""Places in a batch, and which share of them lies within how many cells of the surface."""
_LAST_RATE = 0.1
"""Of the rate that the fit begins with."""
_TRUNCATION = 0.2
"""Distances beyond this, in object units, matter by their sign only."""


def fit_field(field: Field, volume: Volume, *, steps: int, generator: torch.Generator, device: torch.device) -> float:
    """Regress the field to a signed distance by Adam; returns the mean absolute error near its zero, in object units.

    Most of each batch lies within a cell or two of the surface: what is farther is only held on its side of zero and
    roughly in its place.
    """
    values, target = torch.from_numpy(volume.values).to(device).reshape(-1), volume.interpolator(device)
    points = torch.from_numpy(volume.points).to(device)
    near = (values.abs() < _NEAR_CELLS * volume.cell).nonzero()[:, 0]
    if len(near) == 0:
        near = values.abs().topk(min(1000, len(values)), largest=False).indices
    optimizer = Adam(field.fit_groups(), betas=(0.9, 0.99))
    close = round(_NEAR_SHARE * SAMPLES)
    error = float("nan")
    for step in range(steps):
        chosen = near[torch.randint(len(near), (close,), generator=generator).to(device)]
        anywhere = torch.randint(len(points), (SAMPLES - close,), generator=generator).to(device)
        jitter = (torch.rand(SAMPLES, 3, generator=generator) - 0.5).to(points) * volume.cell
        where = points[torch.cat([chosen, anywhere])] + jitter
        wanted = target(where).clamp(-_TRUNCATION, _TRUNCATION)
        sdf = field(where)
        # Where the target is cut, the field may say anything beyond the cut of the right sign.
        cut = wanted.abs() >= 0.999 * _TRUNCATION
        residual = torch.where(cut, (_TRUNCATION - sdf * wanted.sign()).clamp(min=0), (sdf - wanted).abs())
        error = float(residual[:close].detach().mean())
        optimizer.zero_grad()
        residual.mean().backward()
        optimizer.step(_LAST_RATE ** (step / max(1, steps - 1)))
    return error
