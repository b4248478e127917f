import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import RasterizerConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.rasterizers.triton.rasterizer import TritonRasterizer

_OLDEST = (3, 5)
"""Earlier ones know no products of matrices with eight columns."""


@dataclass(frozen=True, kw_only=True)
class TritonRasterizerConfig(RasterizerConfig):
    """Compiled kernels for CUDA devices, in single precision; needs no CUDA compiler."""

    def build(self, device: "torch.device") -> "TritonRasterizer":
        """Raises DeviceError unless the device is a CUDA device, ComponentImportError where Triton is missing.

        Where TRITON_INTERPRET=1 is set, which has Triton run kernels in Python, slowly, the CPU will do as well.
        """
        from sculpt_framework.errors import ComponentImportError, DeviceError

        if device.type != "cuda" and not (device.type == "cpu" and os.environ.get("TRITON_INTERPRET") == "1"):
            raise DeviceError(f"rasterizer 'triton' runs on CUDA devices, not on {device}; use --rasterizer auto")
        try:
            import triton

            version = tuple(int(part) for part in triton.__version__.split(".")[:2])
        except Exception as error:  # Whatever a broken installation raises.
            cause = f"{type(error).__name__}: {error}".splitlines()[0]
            raise ComponentImportError(
                f"rasterizer 'triton' needs the package triton, which cannot be imported ({cause}). It comes with "
                "torch for CUDA on Linux: install that, or choose another rasterizer."
            ) from error
        if version < _OLDEST:
            raise ComponentImportError(
                f"rasterizer 'triton' needs Triton {_OLDEST[0]}.{_OLDEST[1]} or later, but this is "
                f"{triton.__version__}. It comes with torch for CUDA on Linux, 2.9 or later: install that, or choose "
                "another rasterizer."
            )
        from sculpt_plugins.rasterizers.triton.rasterizer import TritonRasterizer

        return TritonRasterizer()
