from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.rasterizers.reference.rasterizer import ReferenceRasterizer


@dataclass(frozen=True, kw_only=True)
class ReferenceRasterizerConfig(RasterizerConfig):
    """Every pixel against every Gaussian in plain torch: any device and precision, exact, slow."""

    pairs_at_once: Annotated[int, at_least(1)] = 2**22
    """Pixel-Gaussian pairs held in memory at a time; images that need more are rendered in pieces."""

    def build(self, device: "torch.device") -> "ReferenceRasterizer":
        from sculpt_plugins.rasterizers.reference.rasterizer import ReferenceRasterizer

        return ReferenceRasterizer(self)
