"""Options of ``pgsr``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig, long_after
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing


@dataclass(frozen=True, kw_only=True)
class PgsrConfig(FreeGaussiansConfig):
    """PGSR (Chen et al. 2024): flat Gaussians as planes, whose depths agree between views."""

    low_pass_px2: Annotated[float, at_least(0)] = 0.3
    """Variance that every Gaussian gains in the image, square pixels."""
    flatness: Annotated[float, at_least(0)] = 100.0
    """Factor of the mean smallest size, in object units."""
    planes_from: Annotated[float, between(0, 1)] = 0.23
    """Share of the run from which on the next three count."""
    single_view: Annotated[float, at_least(0)] = 0.015
    """Factor of the difference between normals and those of the depths, within a view."""
    geometric: Annotated[float, at_least(0)] = 0.03
    """Factor of the pixels by which a point misses itself on the way to another view and back."""
    photometric: Annotated[float, at_least(0)] = 0.15
    """Factor of 1 - NCC between a patch and what another view shows on its plane."""
    samples: Annotated[int, at_least(1)] = 1024
    """Pixels that are compared with another view in a step."""
    rasterizer: RasterizerConfig

    @property
    def stretches(self) -> tuple[float, ...]:
        return long_after(self.planes_from) if self.single_view + self.geometric + self.photometric > 0 else ()

    def build_drawing(self, device: "torch.device") -> "Drawing":
        from sculpt_plugins.methods.pgsr.drawing import PlaneDrawing

        return PlaneDrawing(self, self.rasterizer.build(device))
