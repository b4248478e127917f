"""What methods of free Gaussians have in common."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ExtractorConfig, MethodConfig
from sculpt_framework.ranges import above, at_least, between, require

if TYPE_CHECKING:
    import torch

    from sculpt_framework.free_gaussians.drawing import Drawing
    from sculpt_framework.free_gaussians.meshing import Mesher
    from sculpt_framework.geometry.grid import Grid
    from sculpt_framework.reconstructor import Host, Reconstructor
    from sculpt_framework.types import Camera, Rendering, Scene


@dataclass(frozen=True, kw_only=True)
class DensityConfig:
    """When Gaussians are cloned, split and dropped (3DGS, 5)."""

    every: Annotated[int, at_least(1)] = 100
    """Steps between."""
    begin: Annotated[float, between(0, 1)] = 0.05
    """Share of the run before which nothing is done."""
    end: Annotated[float, between(0, 1)] = 0.6
    """Share of the run after which nothing is done."""
    gradient: Annotated[float, at_least(0)] = 2e-4
    """Mean length of the loss' gradient by place in the image, in half images, from which on one is cloned or split."""
    large: Annotated[float, above(0)] = 0.02
    """Object units: larger ones are split, smaller ones are cloned."""
    least_opacity: Annotated[float, between(0, 1)] = 0.005
    """Those with less are dropped."""
    most: Annotated[int, at_least(1)] = 100_000
    """Gaussians from which on none are added."""
    reset_every: Annotated[int, at_least(0)] = 0
    """Steps after which opacities fall to twice ``least_opacity`` again, so that those that are not needed stay clear
    and are dropped; 0 is never."""


@dataclass(frozen=True, kw_only=True)
class GaussianRates:
    """Learning rates. That of the means falls to a hundredth over the run."""

    means: Annotated[float, at_least(0)] = 1.6e-3
    """Object units per step."""
    scales: Annotated[float, at_least(0)] = 5e-3
    """Of their logarithms."""
    rotations: Annotated[float, at_least(0)] = 1e-3
    """Of quaternions."""
    opacities: Annotated[float, at_least(0)] = 5e-2
    """Of their logits."""
    colors: Annotated[float, at_least(0)] = 2.5e-3
    """Of the constant harmonic; the others learn at a twentieth of it."""


def long_after(*begins: float) -> tuple[float, ...]:
    """As ``FreeGaussiansConfig.stretches``, where terms begin at these shares of the run: once half of what is left is
    over. Earlier states are hardly of these terms, and may well be drawn better. None where all begin at once."""
    last = max(begins, default=0.0)
    return (0.5 * (1 + last),) if last > 0 else ()


@dataclass(frozen=True, kw_only=True)
class FreeGaussiansConfig(MethodConfig, ABC):
    """Gaussians that start at random in the box, one view a step; unless a method has another way, a mesh by fusing
    the depths that they show."""

    gaussians: Annotated[int, at_least(4)] = 10_000
    """How many there are to begin with."""
    sh_degree: Annotated[int, between(0, 3)] = 3
    """Of the spherical harmonics, reached degree by degree."""
    sh_every: Annotated[int, at_least(1)] = 1000
    """Steps after which harmonics get another degree."""
    dssim: Annotated[float, between(0, 1)] = 0.2
    """Share of D-SSIM in the loss."""
    mesh_cells: Annotated[int, at_least(8)] = 128
    """Of the grid that a mesh is made on, along the box's longest side."""
    density: DensityConfig = DensityConfig()
    rates: GaussianRates = GaussianRates()
    extractor: ExtractorConfig

    def check(self) -> None:
        least = self.density.least_opacity
        holds = self.density.reset_every == 0 or 0 < least < 0.5
        require(holds, "density.least-opacity", f"{least:g}", "above 0, below 0.5 with --density.reset-every")

    @abstractmethod
    def build_drawing(self, device: "torch.device") -> "Drawing": ...

    def build_mesher(self, grid: "Grid", device: "torch.device") -> "Mesher":
        from sculpt_framework.free_gaussians.meshing import FusedDepths

        return FusedDepths(grid, self.extractor, device)

    def least_opacity(self, before: float, progress: float) -> float:
        """Gaussians with less are dropped, besides what ``density`` drops, ahead of the step that begins when such a
        share of the run is done; the one before began at ``before``. 0: none."""
        return 0.0

    @property
    def stretches(self) -> tuple[float, ...]:
        """Shares of the run at which what is learned becomes another, or has been learned for long enough: the result
        is of the time after the last."""
        return ()

    def bands(self, steps: int) -> int:
        """How many of the spherical harmonics Gaussians are drawn with after so many steps."""
        return (min(self.sh_degree, steps // self.sh_every) + 1) ** 2

    def pick_device(self) -> "torch.device":
        """Raises DeviceError for one that is not there."""
        from sculpt_framework.device import pick_device

        return pick_device(self.device)

    @property
    def flat(self) -> bool:
        """Whether Gaussians are disks: one of their sizes is next to nothing then, and is not learned."""
        return False

    def build(self, scene: "Scene", host: "Host") -> "Reconstructor":
        from sculpt_framework.free_gaussians.reconstructor import FreeGaussiansReconstructor

        return FreeGaussiansReconstructor(self, scene, host)

    def renderer(self, folder: Path, scene: "Scene") -> "Callable[[Camera], Rendering]":
        from sculpt_framework.free_gaussians.reconstructor import draw_saved

        return draw_saved(self, folder, scene)
