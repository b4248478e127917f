"""Solid textures: colour as a function of position, with detail at several wavelengths, seamless on any shape."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sculpt_framework.demo_scenes.distance import Points, Values

Color = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SolidTexture:
    """Two colours in patches, spots of a third, and brightness at two finer wavelengths."""

    ground: Color
    """sRGB in [0, 1], as the other colours."""
    patches: Color
    spots: Color
    seed: int
    patch_wavelength: float = 0.55
    """World units; about 75 pixels of the default images."""
    spot_wavelength: float = 0.24
    speckle_wavelength: float = 0.11
    grain_wavelength: float = 0.05
    """About seven pixels of the default images: fine, but never near the sampling limit."""
    speckle: float = 0.16
    """Share by which brightness varies at the speckles' wavelength."""
    grain: float = 0.07
    """The same of the grain."""
    plain_beyond: float | None = None
    """Where x is larger than this there is nothing but the ground's colour; None: texture everywhere."""

    def __call__(self, points: Points) -> Float[np.ndarray, "3 n"]:
        """sRGB in [0, 1]."""
        patch = _step(_waves(points, self.patch_wavelength, 9, self.seed), 0.0, 4.0)
        spot = _step(_waves(points, self.spot_wavelength, 9, self.seed + 1), 0.9, 5.0)
        speckle = np.tanh(2 * _waves(points, self.speckle_wavelength, 7, self.seed + 2))
        grain = _waves(points, self.grain_wavelength, 7, self.seed + 3)
        light = 1 + self.speckle * speckle + self.grain * grain
        if self.plain_beyond is not None:
            kept = _step(self.plain_beyond - points[0], 0.0, 20.0)
            patch, spot, light = kept * patch, kept * spot, 1 + kept * (light - 1)
        rows = []
        for ground, patches, spots in zip(self.ground, self.patches, self.spots, strict=True):
            color = ground + (patches - ground) * patch
            rows.append(np.clip((color + (spots - color) * spot) * light, 0, 1))
        return np.stack(rows)


def _waves(points: Points, wavelength: float, count: int, seed: int) -> Values:
    """Plane waves in random directions; mean 0 and variance 1 over space."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions *= 2 * np.pi / wavelength / np.linalg.norm(directions, axis=1, keepdims=True)
    phases = random.uniform(0, 2 * np.pi, size=(count, 1))
    angles = np.einsum("ki,in->kn", directions.astype(points.dtype), points) + phases.astype(points.dtype)
    total = np.sin(angles).sum(axis=0)
    return total * points.dtype.type(np.sqrt(2 / count))


def _step(values: Values, threshold: float, sharpness: float) -> Values:
    """From 0 to 1 around a threshold."""
    return 0.5 + 0.5 * np.tanh(sharpness * (values - threshold))
