"""Colour by direction: real spherical harmonics in the order and with the signs of 3DGS."""

import math
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.cpu_kernels import array_of, float32_on_cpu, kernel_cache, share_threads

with kernel_cache("harmonics", Path(__file__).with_name("spherical_harmonics_kernels.py")):
    from sculpt_framework.rendering import spherical_harmonics_kernels as kernels

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
    single band neither is read. float32 on the CPU runs in compiled kernels, anything else in torch. Raises ValueError
    unless there are 1, 4, 9 or 16 coefficients (degrees 0 to 3).
    """
    count = sh.shape[1]
    if count not in _DEGREE_OF_COUNT:
        raise ValueError(f"spherical harmonics have 1, 4, 9 or 16 coefficients (degrees 0 to 3), not {count}")
    if count == 1:
        return torch.add(0.5, sh[:, 0], alpha=BAND_0).clamp_min(0.0)
    if float32_on_cpu(sh, means, camera_position):
        return _CompiledColors.apply(sh, means, camera_position)
    return sh_to_rgb_in_torch(sh, means, camera_position)


def sh_to_rgb_in_torch(
    sh: Float[Tensor, "g b 3"], means: Float[Tensor, "g 3"], camera_position: Float[Tensor, " 3"]
) -> Float[Tensor, "g 3"]:
    """``sh_to_rgb`` of more than one band in plain torch: any device and floating-point type."""
    offset = means - camera_position
    squared = offset.square().sum(dim=1, keepdim=True)
    # Twice, as the gradient of what is not taken must be finite, too.
    inverse = torch.where(squared == 0, 0.0, torch.where(squared == 0, 1.0, squared).rsqrt())
    direction = offset * inverse
    basis = spherical_harmonics(direction, _DEGREE_OF_COUNT[sh.shape[1]])
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


class _CompiledColors(torch.autograd.Function):
    @staticmethod
    def forward(ctx, sh: Tensor, means: Tensor, camera_position: Tensor) -> Tensor:
        rgb, clamped = torch.empty(len(sh), 3), torch.empty(len(sh), 3, dtype=torch.bool)
        share_threads()
        kernels.shade(array_of(sh), array_of(means), array_of(camera_position), rgb.numpy(), clamped.numpy())
        ctx.save_for_backward(sh, means, camera_position, clamped)
        return rgb

    @staticmethod
    @once_differentiable
    def backward(ctx, to_rgb: Tensor) -> tuple[Tensor | None, ...]:
        sh, means, camera_position, clamped = ctx.saved_tensors
        by_place = ctx.needs_input_grad[1] or ctx.needs_input_grad[2]
        to_sh, to_means = torch.empty(sh.shape), torch.empty(len(means) if by_place else 0, 3)
        share_threads()
        kernels.shade_backward(
            array_of(sh), array_of(means), array_of(camera_position), clamped.numpy(), array_of(to_rgb),
            to_sh.numpy(), to_means.numpy(),
        )  # fmt: skip
        if not by_place:
            return to_sh, None, None
        return to_sh, to_means, -to_means.sum(dim=0)
