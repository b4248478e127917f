from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import RasterizerConfig

if TYPE_CHECKING:
    import torch

    from sculpt_framework.rasterizers import Rasterizer


@dataclass(frozen=True, kw_only=True)
class AutoRasterizerConfig(RasterizerConfig):
    """The fastest backend there is for the device."""

    def build(self, device: "torch.device") -> "Rasterizer":
        """numba on the CPU; on CUDA triton, else gsplat; the reference where none of them runs. Logs which, and why."""
        from sculpt_plugins.rasterizers.auto.choice import choose

        return choose(device)
