"""What methods of Gaussians beside a field have in common."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import FieldConfig, RasterizerConfig
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.ranges import above, at_least
from sculpt_framework.volume_rendering.config import RadianceConfig, SdfShape, ShapeWeights

if TYPE_CHECKING:
    import torch

    from sculpt_framework.guided_gaussians.drawing import FacingSplatting
    from sculpt_framework.guided_gaussians.guide import Guide
    from sculpt_framework.reconstructor import Host, Reconstructor
    from sculpt_framework.types import Scene
    from sculpt_framework.volume_rendering.logistic import LogisticVolume


@dataclass(frozen=True, kw_only=True)
class RaysConfig:
    """How rays pass the field, as they do in NeuS."""

    number: Annotated[int, at_least(1)] = 512
    """Pixels of its view that a step learns from."""
    steps_across: Annotated[int, at_least(8)] = 128
    """Steps along a ray as long as the box's longest side."""
    cells: Annotated[int, at_least(4)] = 64
    """Of the grid that keeps where something may be, along the box's longest side."""
    mask_weight: Annotated[float, at_least(0)] = 0.1
    """Factor of the cross entropy between masks and what rays meet."""
    eikonal_weight: Annotated[float, at_least(0)] = 0.1
    """Factor of the mean squared difference of the field's slope from 1."""
    sharpness: Annotated[float, above(0)] = 60.0
    """Of the logistic function, to begin with, per object unit. It is learned."""
    sharpness_rate: Annotated[float, at_least(0)] = 3e-3
    """Learning rate of a tenth of its logarithm."""
    final_rate: Annotated[float, above(0, at_most=1)] = 0.2
    """The field's learning rates end at this share of themselves."""


@dataclass(frozen=True, kw_only=True)
class AgreementConfig:
    """How much it counts that both show the same."""

    depth: Annotated[float, at_least(0)] = 0.1
    """Factor of the mean difference between depths, in object units."""
    normal: Annotated[float, at_least(0)] = 0.01
    """Factor of 1 - the mean cosine between normals."""


@dataclass(frozen=True, kw_only=True)
class GuidedGaussiansConfig(FreeGaussiansConfig, ABC):
    """Gaussians and a field that learn from one view a step, and from each other's depths and normals; the mesh is the
    field's zero."""

    mesh_cells: Annotated[int, at_least(8)] = 128
    """Of the grid the mesh is extracted on, along the box's longest side; rounded down to a multiple of four."""
    low_pass_px2: Annotated[float, at_least(0)] = 0.3
    """Variance that every Gaussian gains in the image, square pixels."""
    rays: RaysConfig = RaysConfig()
    agreement: AgreementConfig = AgreementConfig()
    field: FieldConfig
    rasterizer: RasterizerConfig

    @abstractmethod
    def build_guide(self) -> "Guide":
        """As it is before anything is learned, on the CPU. What is random in it follows torch's own generator."""

    @property
    def alone_until(self) -> float:
        """Share of the run from which on the field learns; the Gaussians are alone before."""
        return 0.0

    @property
    def ray_colors(self) -> RadianceConfig | None:
        """What the colours that rays bring are made of; None where they bring none."""
        return None

    def build_volume(self) -> "LogisticVolume":
        from sculpt_framework.volume_rendering.logistic import LogisticVolume

        shape = SdfShape(
            field=self.field,
            radiance=self.ray_colors,
            weights=ShapeWeights(eikonal=self.rays.eikonal_weight),
            mesh_cells=self.mesh_cells,
        )
        return LogisticVolume(shape, self.rays.sharpness, self.rays.sharpness_rate)

    def build_drawing(self, device: "torch.device") -> "FacingSplatting":
        from sculpt_framework.guided_gaussians.drawing import FacingSplatting

        return FacingSplatting(self.rasterizer.build(device), self.low_pass_px2, self.dssim)

    def build(self, scene: "Scene", host: "Host") -> "Reconstructor":
        from sculpt_framework.guided_gaussians.reconstructor import GuidedGaussiansReconstructor

        return GuidedGaussiansReconstructor(self, scene, host)
