"""Options of ``relightable``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig, long_after
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing


@dataclass(frozen=True, kw_only=True)
class MaterialRates:
    """Learning rates of what each Gaussian, and the light, learn beside 3DGS."""

    normals: Annotated[float, at_least(0)] = 1e-2
    """Of vectors that are normalised where they are used."""
    albedo: Annotated[float, at_least(0)] = 1e-2
    """Of logits."""
    roughness: Annotated[float, at_least(0)] = 1e-2
    """Of logits."""
    visibility: Annotated[float, at_least(0)] = 2.5e-3
    """Of logits."""
    light: Annotated[float, at_least(0)] = 1e-2
    """Of the light's harmonics."""


@dataclass(frozen=True, kw_only=True)
class RelightableConfig(FreeGaussiansConfig):
    """Relightable 3D Gaussian (Gao et al. 2024): Gaussians with normals and materials under one light from afar."""

    low_pass_px2: Annotated[float, at_least(0)] = 0.3
    """Variance that every Gaussian gains in the image, square pixels."""
    normal: Annotated[float, at_least(0)] = 0.01
    """Factor of the mean squared difference between normals and those of the depths."""
    spread: Annotated[float, at_least(0)] = 0.01
    """Factor of the mean standard deviation of the depth at a pixel, in object units; it grows to a hundred times that
    until a third of the way to the materials."""
    mask: Annotated[float, at_least(0)] = 0.1
    """Factor of the cross entropy between masks, where there are any, and coverage."""
    materials_from: Annotated[float, between(0, 1)] = 0.75
    """Share of the run from which on colours are explained by materials and light as well."""
    shaded: Annotated[float, at_least(0)] = 1.0
    """Factor of the colour loss of what materials and light make."""
    white: Annotated[float, at_least(0)] = 0.01
    """Factor of how far the light is from grey: mean difference of its harmonics from their mean over the channels."""
    material_rates: MaterialRates = MaterialRates()
    rasterizer: RasterizerConfig

    @property
    def stretches(self) -> tuple[float, ...]:
        return long_after(self.materials_from) if self.shaded > 0 else ()

    def build_drawing(self, device: "torch.device") -> "Drawing":
        from sculpt_plugins.methods.relightable.drawing import RelightableDrawing

        return RelightableDrawing(self, self.rasterizer.build(device), device)
