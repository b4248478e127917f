from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import AppearanceConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.appearances.color_field.appearance import ColorFieldAppearance


@dataclass(frozen=True, kw_only=True)
class ColorFieldConfig(AppearanceConfig):
    """A pyramid of colour grids over position, and a small residual on every Gaussian."""

    sh_degree: int = 0
    """Degree of the residual's spherical harmonics, 0 to 3; 0 means colour does not depend on the view."""
    num_levels: int = 5
    """Levels of the pyramid."""
    log2_table: int = 19
    """Entries per level at most, as a power of two."""
    base_resolution: int = 8
    """Cells across [-1, 1] at the coarsest level."""
    finest_resolution: int = 128
    """Cells across [-1, 1] at the finest level."""
    rate: float = 1e-2
    """Adam's rate of the pyramid, in units of the band-0 coefficient."""
    residual_rate: float = 2.5e-3
    """Adam's rate of the residuals' band 0."""
    rest_rate: float = 1.25e-4
    """Adam's rate of the residuals' higher bands."""

    def build(self, device: "torch.device") -> "ColorFieldAppearance":
        from sculpt_plugins.appearances.color_field.appearance import ColorFieldAppearance

        return ColorFieldAppearance(self).to(device)
