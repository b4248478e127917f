"""Colour by direction: real spherical harmonics in the order and with the signs of 3DGS."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

BAND_0 = 0.5 / math.sqrt(math.pi)
"""The constant harmonic."""
_BAND_1 = math.sqrt(3.0 / (4.0 * math.pi))
_DEGREE_OF_COUNT = {1: 0, 4: 1, 9: 2, 16: 3}


def sh_to_rgb(
    sh: Float[Tensor, "g b 3"], means: Float[Tensor, "g 3"], camera_position: Float[Tensor, " 3"]
) -> Float[Tensor, "g 3"]:
    """The colour of each Gaussian seen from the camera: max(0, 0.5 + sum_b sh_b Y_b(direction)).

    ``means`` and ``camera_position`` are in the same frame. The direction runs from the camera to the mean; for a mean
    at the camera it is zero, so that only the constant band counts and no gradient reaches the positions. With a
    single band neither is read. Raises ValueError unless there are 1, 4, 9 or 16 coefficients (degrees 0 to 3).
    """
    count = sh.shape[1]
    if count not in _DEGREE_OF_COUNT:
        raise ValueError(f"spherical harmonics have 1, 4, 9 or 16 coefficients (degrees 0 to 3), not {count}")
    if count == 1:
        return torch.add(0.5, sh[:, 0], alpha=BAND_0).clamp_min(0.0)
    offset = means - camera_position
    # A zero offset would give 0/0; one in place of its squared length leaves the direction 0 and its gradient finite.
    squared = offset.square().sum(dim=1, keepdim=True)
    direction = offset * torch.where(squared > 0, squared, 1.0).rsqrt()
    basis = spherical_harmonics(direction, _DEGREE_OF_COUNT[count])
    return (0.5 + torch.einsum("gb,gbc->gc", basis, sh)).clamp_min(0.0)


def spherical_harmonics(directions: Float[Tensor, "n 3"], degree: int) -> Float[Tensor, "n b"]:
    """The real spherical harmonics up to ``degree`` (at most 3) at unit vectors, orthonormal on the sphere."""
    x, y, z = directions.unbind(dim=1)
    bands = [torch.full_like(x, BAND_0)]
    if degree >= 1:
        bands += [-_BAND_1 * y, _BAND_1 * z, -_BAND_1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        c = math.sqrt(15.0 / math.pi)
        bands += [
            0.5 * c * x * y,
            -0.5 * c * y * z,
            0.25 * math.sqrt(5.0 / math.pi) * (2.0 * zz - xx - yy),
            -0.5 * c * x * z,
            0.25 * c * (xx - yy),
        ]
        if degree >= 3:
            outer, middle = 0.25 * math.sqrt(35.0 / (2.0 * math.pi)), 0.25 * math.sqrt(21.0 / (2.0 * math.pi))
            inner, cube = math.sqrt(105.0 / math.pi), 0.25 * math.sqrt(7.0 / math.pi)
            bands += [
                -outer * y * (3.0 * xx - yy),
                0.5 * inner * x * y * z,
                -middle * y * (4.0 * zz - xx - yy),
                cube * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                -middle * x * (4.0 * zz - xx - yy),
                0.25 * inner * z * (xx - yy),
                -outer * x * (xx - 3.0 * yy),
            ]
    return torch.stack(bands, dim=1)
