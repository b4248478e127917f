"""Orthonormal axes of flat Gaussians given by conjugate radii."""

from dataclasses import replace

import torch

from sculpt_framework.types import Gaussians


@torch.no_grad()
def principal_axes(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians with right-handed rotations: column 0 the normal, column 1 the longest tangential axis.

    Not differentiable, on purpose: axes of a round Gaussian are arbitrary and have no derivative. A Gaussian whose
    tangential columns are parallel (a face of no area) gets an arbitrary second tangent of scale 0.
    """
    rotations, scales = gaussians.rotations.double(), gaussians.scales.double()
    normal = rotations[:, :, 0]
    factor = rotations[:, :, 1:] * scales[:, None, 1:]
    first, singular, _ = torch.linalg.svd(factor, full_matrices=True)
    long = first[:, :, 0]
    # A degenerate face may have no normal of its own: take the direction its Gaussian has no extent in.
    # Single precision leaves normals of slivers askew: what lies along the long axis is taken out of them.
    normal = normal - (normal * long).sum(dim=1, keepdim=True) * long
    length = normal.norm(dim=1, keepdim=True)
    normal = torch.where(length > 0.5, normal / length.clamp(min=1e-30), first[:, :, 2])
    across = torch.cross(normal, long, dim=1)
    axes = torch.stack([normal, long, across], dim=2)
    widths = torch.cat([scales[:, :1], singular], dim=1)
    return replace(gaussians, rotations=axes.to(gaussians.rotations), scales=widths.to(gaussians.scales))
