"""Options of ``splatting-3d``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing


@dataclass(frozen=True, kw_only=True)
class Splatting3dConfig(FreeGaussiansConfig):
    """3DGS (Kerbl et al. 2023): Gaussians that are cloned, split and dropped; nothing holds them to a surface."""

    low_pass_px2: Annotated[float, at_least(0)] = 0.3
    """Variance that every Gaussian gains in the image, square pixels."""
    rasterizer: RasterizerConfig

    def build_drawing(self, device: "torch.device") -> "Drawing":
        from sculpt_framework.free_gaussians.drawing import Splatting

        return Splatting(self.rasterizer.build(device), self.low_pass_px2, self.dssim)
