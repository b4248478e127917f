"""What light from afar makes of a place with a normal and a material (Gao et al. 2024, simplified).

The light is a sum of real spherical harmonics, so that the integrals over directions are sums over its bands:

- Diffuse: albedo / pi times the irradiance, whose harmonics are the light's times pi, 2 pi / 3, pi / 4, 0 (Ramamoorthi
  and Hanrahan 2001).
- Specular: the split sum. The light seen along the mirrored view, blurred as microfacets of Beckmann's slopes would,
  times F0 A + B (Karis 2014, his fit for mobile devices), F0 = 0.04.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.rendering.spherical_harmonics import spherical_harmonics

LIGHT_DEGREE = 3
_IRRADIANCE = (math.pi, 2 * math.pi / 3, math.pi / 4, 0.0)
"""What each band of the light counts in the irradiance."""
_F0 = 0.04
"""Reflectance of what conducts no current, seen straight on (place not checked)."""
_KNEE = 0.0031308
"""Of the sRGB curve, which is straight below it."""


def shade(
    normals: Float[Tensor, "g 3"],
    towards: Float[Tensor, "g 3"],
    albedo: Float[Tensor, "g 3"],
    roughness: Float[Tensor, " g"],
    visibility: Float[Tensor, " g"],
    light: Float[Tensor, "b 3"],
) -> Float[Tensor, "g 3"]:
    """Linear radiance towards the viewer, at least 0. ``normals`` and ``towards`` are unit; a vector of length 0, which
    has no direction, gives what the constant band gives. ``visibility`` is the share of the light that arrives."""
    along = (normals * towards).sum(dim=1, keepdim=True)
    mirrored = 2 * along * normals - towards
    bands = _band_of_each(light)
    irradiance = spherical_harmonics(normals, LIGHT_DEGREE) @ (light * light.new_tensor(_IRRADIANCE)[bands][:, None])
    # Slopes of variance alpha^2 / 2 turn the mirrored ray by twice as much: on the sphere, heat after alpha^2.
    alpha_squared = roughness[:, None].pow(4)
    blurred = torch.exp(-alpha_squared * (bands * (bands + 1)).to(light))
    reflected = (spherical_harmonics(mirrored, LIGHT_DEGREE) * blurred) @ light
    scale, offset = _split_sum(along[:, 0].clamp(0, 1), roughness)
    diffuse = albedo / math.pi * irradiance.clamp_min(0)
    specular = (_F0 * scale + offset)[:, None] * reflected.clamp_min(0)
    return visibility[:, None] * (diffuse + specular)


def _band_of_each(light: Float[Tensor, "b 3"]) -> Tensor:
    return torch.arange(len(light), device=light.device).float().sqrt().floor().long()


def _split_sum(
    facing: Float[Tensor, " g"], roughness: Float[Tensor, " g"]
) -> tuple[Float[Tensor, " g"], Float[Tensor, " g"]]:
    """A and B of the reflected share F0 A + B, by the cosine between normal and view (Karis 2014)."""
    first = [1 - roughness, 0.0425 - 0.0275 * roughness, 1.04 - 0.572 * roughness, 0.022 * roughness - 0.04]
    grazing = torch.minimum(first[0].square(), torch.exp2(-9.28 * facing)) * first[0] + first[1]
    return first[2] - 1.04 * grazing, first[3] + 1.04 * grazing


def encode_srgb(linear: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """sRGB of linear light, at least 0: straight up to the knee, so that black has a slope."""
    above = linear > _KNEE
    bent = 1.055 * torch.where(above, linear, 1.0).pow(1 / 2.4) - 0.055
    return torch.where(above, bent, 12.92 * linear)


def unit(vectors: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Of length 1; 0, without gradient, where there is no length."""
    squared = vectors.square().sum(dim=1, keepdim=True)
    return torch.where(squared > 0, vectors * torch.where(squared > 0, squared, 1.0).rsqrt(), 0.0)
