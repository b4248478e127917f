from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import AppearanceConfig
from sculpt_framework.ranges import at_least, between, require_levels

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.appearances.color_field.appearance import ColorFieldAppearance


@dataclass(frozen=True, kw_only=True)
class ColorFieldConfig(AppearanceConfig):
    """A pyramid of colour grids over position, and a small residual on every Gaussian."""

    sh_degree: Annotated[int, between(0, 3)] = 0
    """Degree of the residual's spherical harmonics, 0 to 3; 0 means colour does not depend on the view."""
    num_levels: Annotated[int, at_least(1)] = 5
    """Levels of the pyramid."""
    log2_table: Annotated[int, between(1, 31)] = 19
    """Entries per level at most, as a power of two."""
    base_resolution: Annotated[int, at_least(1)] = 8
    """Cells across [-1, 1] at the coarsest level."""
    finest_resolution: Annotated[int, at_least(1)] = 128
    """Cells across [-1, 1] at the finest level."""
    rate: Annotated[float, at_least(0)] = 1e-2
    """Learning rate of the pyramid, in units of the band-0 coefficient."""
    residual_rate: Annotated[float, at_least(0)] = 2.5e-3
    """Learning rate of the residuals' band 0."""
    rest_rate: Annotated[float, at_least(0)] = 1.25e-4
    """Learning rate of the residuals' higher bands."""

    def check(self, option: str) -> None:
        require_levels(option, self.num_levels, self.base_resolution, self.finest_resolution)

    def build(self, device: "torch.device") -> "ColorFieldAppearance":
        from sculpt_plugins.appearances.color_field.appearance import ColorFieldAppearance

        return ColorFieldAppearance(self).to(device)
