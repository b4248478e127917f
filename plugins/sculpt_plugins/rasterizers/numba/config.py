from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import RasterizerConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.rasterizers.numba.rasterizer import NumbaRasterizer


@dataclass(frozen=True, kw_only=True)
class NumbaRasterizerConfig(RasterizerConfig):
    """Compiled vector kernels for the CPU, in single precision, on as many threads as torch uses."""

    deterministic: bool = False
    """Gradients the same to the last bit whatever the number of threads, not only from run to run with the same."""

    def build(self, device: "torch.device") -> "NumbaRasterizer":
        """Raises DeviceError unless the device is the CPU."""
        from sculpt_framework.errors import DeviceError

        if device.type != "cpu":
            raise DeviceError(f"rasterizer 'numba' runs on the CPU, not on {device}; use --rasterizer auto")
        from sculpt_plugins.rasterizers.numba.rasterizer import NumbaRasterizer

        return NumbaRasterizer(self)
