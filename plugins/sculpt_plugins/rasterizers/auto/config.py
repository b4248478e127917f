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
        """numba on the CPU; elsewhere triton where it can be had, else the reference. Logs which, and why."""
        from sculpt_plugins.rasterizers.auto.choice import choose

        return choose(device).build(device)
