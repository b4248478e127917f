from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import RasterizerConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.rasterizers.gsplat.rasterizer import GsplatRasterizer


@dataclass(frozen=True, kw_only=True)
class GsplatRasterizerConfig(RasterizerConfig):
    """The package gsplat: CUDA kernels that are compiled on first use and need a CUDA compiler."""

    def build(self, device: "torch.device") -> "GsplatRasterizer":
        """Raises DeviceError unless the device is a CUDA device and the kernels run on it, ComponentImportError where
        the package is missing."""
        from sculpt_framework.errors import DeviceError

        if device.type != "cuda":
            raise DeviceError(f"rasterizer 'gsplat' runs on CUDA devices, not on {device}; use --rasterizer auto")
        from sculpt_plugins.rasterizers.gsplat.rasterizer import GsplatRasterizer, load_gsplat

        return GsplatRasterizer(load_gsplat(device))
