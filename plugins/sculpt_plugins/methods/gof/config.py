"""Options of ``gof``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.free_gaussians.config import FreeGaussiansConfig, long_after
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing
    from sculpt_framework.free_gaussians.meshing import Mesher
    from sculpt_framework.geometry.grid import Grid


@dataclass(frozen=True, kw_only=True)
class GofConfig(FreeGaussiansConfig):
    """GOF (Yu et al. 2024): Gaussians met by rays, and a level of the opacity that they have from all sides. CPU."""

    distortion: Annotated[float, at_least(0)] = 100.0
    """Factor of the depth distortion."""
    distortion_from: Annotated[float, between(0, 1)] = 0.5
    """Share of the run from which on it counts."""
    normals: Annotated[float, at_least(0)] = 0.05
    """Factor of the difference between Gaussians' normals and those of the depths."""
    normals_from: Annotated[float, between(0, 1)] = 0.5
    """Share of the run from which on it counts."""
    smoothing: Annotated[float, at_least(0)] = 0.2
    """Variance that every Gaussian gains in space, in squared pixels at its depth."""
    level: Annotated[float, between(0, 1)] = 0.5
    """Opacity at the surface."""
    bisections: Annotated[int, at_least(0)] = 8
    """Halvings of an edge of a tetrahedron that crosses the surface."""
    mesh_gaussians: Annotated[int, at_least(8)] = 30_000
    """Gaussians, drawn at random from those there are, at which tetrahedra have their corners."""

    @property
    def stretches(self) -> tuple[float, ...]:
        terms = ((self.distortion, self.distortion_from), (self.normals, self.normals_from))
        return long_after(*(begin for factor, begin in terms if factor > 0))

    def pick_device(self) -> "torch.device":
        import torch

        from sculpt_framework.errors import DeviceError

        if self.device == "cuda":
            raise DeviceError("gof draws its Gaussians on the CPU; use --device cpu or auto")
        return torch.device("cpu")

    def build_drawing(self, device: "torch.device") -> "Drawing":
        from sculpt_plugins.methods.gof.drawing import RayDrawing

        return RayDrawing(self)

    def build_mesher(self, grid: "Grid", device: "torch.device") -> "Mesher":
        from sculpt_plugins.methods.gof.tetrahedra import OpacityMesher

        return OpacityMesher(self, grid)
