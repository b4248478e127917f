"""Sines and cosines of growing frequency (NeRF), with the identity first."""

import torch
from jaxtyping import Float
from torch import Tensor


def positional_encoding(points: Float[Tensor, "n 3"], frequencies: int) -> Float[Tensor, "n c"]:
    """(x, sin 2^0 x, cos 2^0 x, ..., sin 2^(L-1) x, cos 2^(L-1) x): 3 + 6 L channels."""
    if frequencies == 0:
        return points
    octaves = 2.0 ** torch.arange(frequencies, dtype=points.dtype, device=points.device)
    phases = (points[:, None, :] * octaves[:, None]).unsqueeze(2)
    waves = torch.cat([phases.sin(), phases.cos()], dim=2)
    return torch.cat([points, waves.flatten(1)], dim=1)
