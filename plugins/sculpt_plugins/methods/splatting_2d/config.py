"""Options of ``splatting-2d``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.free_gaussians.config import FreeGaussiansConfig, long_after
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing


@dataclass(frozen=True, kw_only=True)
class Splatting2dConfig(FreeGaussiansConfig):
    """2DGS (Huang et al. 2024): disks met by rays, drawn together along them and turned as their depths are. CPU."""

    distortion: Annotated[float, at_least(0)] = 1000.0
    """Factor of the depth distortion."""
    distortion_from: Annotated[float, between(0, 1)] = 0.1
    """Share of the run from which on it counts."""
    normals: Annotated[float, at_least(0)] = 0.05
    """Factor of the difference between disks' normals and those of the depths."""
    normals_from: Annotated[float, between(0, 1)] = 0.23
    """Share of the run from which on it counts."""

    @property
    def stretches(self) -> tuple[float, ...]:
        terms = ((self.distortion, self.distortion_from), (self.normals, self.normals_from))
        return long_after(*(begin for factor, begin in terms if factor > 0))

    def pick_device(self) -> "torch.device":
        import torch

        from sculpt_framework.errors import DeviceError

        if self.device == "cuda":
            raise DeviceError("splatting-2d draws its disks on the CPU; use --device cpu or auto")
        return torch.device("cpu")

    @property
    def flat(self) -> bool:
        return True

    def build_drawing(self, device: "torch.device") -> "Drawing":
        from sculpt_plugins.methods.splatting_2d.drawing import DiskDrawing

        return DiskDrawing(self)
