from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import AppearanceConfig
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.appearances.per_gaussian.appearance import PerGaussianAppearance


@dataclass(frozen=True, kw_only=True)
class PerGaussianConfig(AppearanceConfig):
    """Spherical harmonics on every Gaussian, kept under its face's key (the paper's appearance)."""

    sh_degree: Annotated[int, between(0, 3)] = 0
    """Degree of the spherical harmonics, 0 to 3 (3DGS: 3); 0 means colour does not depend on the view."""
    rate: Annotated[float, at_least(0)] = 2.5e-3
    """Learning rate of band 0 (3DGS: 0.0025)."""
    rest_rate: Annotated[float, at_least(0)] = 1.25e-4
    """Learning rate of the higher bands (3DGS: 0.0025 / 20)."""

    def build(self, device: "torch.device") -> "PerGaussianAppearance":
        from sculpt_plugins.appearances.per_gaussian.appearance import PerGaussianAppearance

        return PerGaussianAppearance(self)
