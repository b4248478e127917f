import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import RasterizerConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.rasterizers.triton.rasterizer import TritonRasterizer


@dataclass(frozen=True, kw_only=True)
class TritonRasterizerConfig(RasterizerConfig):
    """Compiled kernels for CUDA devices, in single precision; needs no CUDA compiler."""

    def build(self, device: "torch.device") -> "TritonRasterizer":
        """Raises DeviceError unless the device is a CUDA device and kernels run on it, ComponentImportError where
        Triton is missing.

        Where TRITON_INTERPRET=1 is set, which has Triton run kernels in Python, slowly, the CPU will do as well.
        """
        from sculpt_framework.errors import DeviceError, first_line
        from sculpt_framework.triton_package import require_triton

        if device.type != "cuda" and not (device.type == "cpu" and os.environ.get("TRITON_INTERPRET") == "1"):
            raise DeviceError(f"rasterizer 'triton' runs on CUDA devices, not on {device}; use --rasterizer auto")
        require_triton("rasterizer 'triton'", "choose another rasterizer")
        from sculpt_plugins.rasterizers.triton.rasterizer import TritonRasterizer

        rasterizer = TritonRasterizer()
        if device.type == "cuda":
            try:
                rasterizer.draw_one(device)
            except Exception as error:  # A missing compiler, driver or header shows as anything.
                raise DeviceError(
                    f"rasterizer 'triton' does not run on {device} ({first_line(error)}). Triton needs a C compiler, "
                    "such as gcc, and the header Python.h: install them, or choose another rasterizer."
                ) from error
        return rasterizer
