"""Options of ``sugar``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.ranges import above, at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing
    from sculpt_framework.free_gaussians.meshing import Mesher
    from sculpt_framework.geometry.grid import Grid


@dataclass(frozen=True, kw_only=True)
class PoissonConfig:
    """The Poisson surface of points at a level of the density (4.2)."""

    level: Annotated[float, above(0)] = 0.3
    """Density at the surface."""
    points: Annotated[int, at_least(100)] = 100_000
    """Rays along which that level is looked for, over all views."""
    depth: Annotated[int, between(3, 12)] = 7
    """Of the octree that the mesh is made on: cells are a side of the surface's box by two to the power of it."""


@dataclass(frozen=True, kw_only=True)
class SugarConfig(FreeGaussiansConfig):
    """SuGaR (Guedon and Lepetit 2024): Gaussians drawn to one surface, and the Poisson surface of a level of their
    density. Without the refinement, in which Gaussians are bound to the mesh. Needs the extra ``pose``."""

    low_pass_px2: Annotated[float, at_least(0)] = 0.3
    """Variance that every Gaussian gains in the image, square pixels."""
    entropy_from: Annotated[float, between(0, 1)] = 0.47
    """Share of the run from which on opacities are drawn to 0 and 1, until the surface counts."""
    entropy: Annotated[float, at_least(0)] = 0.1
    """Factor of the mean entropy of opacities, in nats."""
    surface_from: Annotated[float, between(0, 1)] = 0.6
    """Share of the run at which clear Gaussians are dropped, and from which on the next two count."""
    clear: Annotated[float, between(0, 1)] = 0.5
    """Gaussians with less opacity are dropped then."""
    distance: Annotated[float, at_least(0)] = 0.5
    """Factor of the difference, in object units, between the density's distance and that from the depths."""
    normals: Annotated[float, at_least(0)] = 0.2
    """Factor of the squared difference between the density's normals and those of Gaussians."""
    samples: Annotated[int, at_least(1)] = 4096
    """Points that are looked at in a step."""
    poisson: PoissonConfig = PoissonConfig()
    rasterizer: RasterizerConfig

    def build_drawing(self, device: "torch.device") -> "Drawing":
        from sculpt_plugins.methods.sugar.drawing import SurfaceDrawing

        return SurfaceDrawing(self, self.rasterizer.build(device))

    def build_mesher(self, grid: "Grid", device: "torch.device") -> "Mesher":
        """Raises ComponentImportError where the library that makes Poisson surfaces is missing."""
        from sculpt_plugins.methods.sugar.poisson import PoissonMesher

        return PoissonMesher(self, grid, device)

    def least_opacity(self, before: float, progress: float) -> float:
        """Once, as the surface begins to count."""
        return self.clear if before < self.surface_from <= progress else 0.0

    @property
    def stretches(self) -> tuple[float, ...]:
        return (self.surface_from,)
