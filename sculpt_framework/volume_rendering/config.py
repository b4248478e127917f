"""What methods that render a volume along rays have in common."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ExtractorConfig, FieldConfig, MethodConfig
from sculpt_framework.ranges import above, at_least, between, require_levels

if TYPE_CHECKING:
    from sculpt_framework.reconstructor import Host, Reconstructor
    from sculpt_framework.types import Camera, Rendering, Scene
    from sculpt_framework.volume_rendering.volume import Volume


@dataclass(frozen=True, kw_only=True)
class RadianceConfig:
    """Colour by place and direction: features of a hash grid, decoded together with the direction."""

    num_levels: Annotated[int, at_least(1)] = 6
    """Levels of the grid."""
    log2_table: Annotated[int, between(1, 31)] = 17
    """Entries per level at most, as a power of two."""
    base_resolution: Annotated[int, at_least(1)] = 8
    """Cells across [-1, 1] at the coarsest level."""
    finest_resolution: Annotated[int, at_least(1)] = 256
    """Cells across [-1, 1] at the finest level."""
    hidden_units: Annotated[int, at_least(1)] = 32
    """Units of each of the decoder's two hidden layers."""
    rate: Annotated[float, at_least(0)] = 1e-2
    """Learning rate of the grid."""
    decoder_rate: Annotated[float, at_least(0)] = 2e-3
    """Learning rate of the decoder."""

    def check(self, option: str) -> None:
        """Raises ConfigError, as a component's does."""
        require_levels(option, self.num_levels, self.base_resolution, self.finest_resolution)


@dataclass(frozen=True, kw_only=True)
class Passing:
    """How rays pass a volume while it learns: as ``VolumeConfig`` has it."""

    rays: int
    steps_across: int
    cells: int
    mask_weight: float

    @property
    def step(self) -> float:
        """Length of a step, in object units."""
        return 2.0 / self.steps_across


@dataclass(frozen=True, kw_only=True)
class VolumeConfig(MethodConfig, ABC):
    """Rays through pixels chosen at random, looked at in equal steps through the cells that may hold something."""

    rays: Annotated[int, at_least(1)] = 1024
    """Pixels a step learns from."""
    steps_across: Annotated[int, at_least(8)] = 128
    """Steps along a ray as long as the box's longest side."""
    cells: Annotated[int, at_least(4)] = 64
    """Of the grid that keeps where something may be, along the box's longest side."""
    mesh_cells: Annotated[int, at_least(8)] = 128
    """Of the grid the mesh is extracted on, along the box's longest side; rounded down to a multiple of four."""
    mask_weight: Annotated[float, at_least(0)] = 0.1
    """Factor of the cross entropy between masks and what rays meet."""
    final_rate: Annotated[float, above(0, at_most=1)] = 0.2
    """Learning rates end at this share of themselves."""
    radiance: RadianceConfig = RadianceConfig()
    extractor: ExtractorConfig

    def check(self) -> None:
        self.radiance.check("radiance")

    @property
    def passing(self) -> Passing:
        return Passing(rays=self.rays, steps_across=self.steps_across, cells=self.cells, mask_weight=self.mask_weight)

    @abstractmethod
    def build_volume(self) -> "Volume":
        """As it is before anything is learned, on the CPU. What is random in it follows torch's own generator."""

    def build(self, scene: "Scene", host: "Host") -> "Reconstructor":
        from sculpt_framework.volume_rendering.reconstructor import VolumeReconstructor

        return VolumeReconstructor(self, scene, host)

    def renderer(self, folder: Path, scene: "Scene") -> "Callable[[Camera], Rendering]":
        from sculpt_framework.volume_rendering.reconstructor import draw_saved_volume

        return draw_saved_volume(self, folder, scene)


@dataclass(frozen=True, kw_only=True)
class ShapeWeights:
    """Factors of the terms of a field's own shape."""

    eikonal: float
    """Of the mean squared difference of its slope from 1."""
    bending: float = 0.0
    """Of the mean size of its Laplacian beside the surface."""


@dataclass(frozen=True, kw_only=True)
class SdfShape:
    """What a volume of a signed distance field is made of."""

    field: FieldConfig
    field_rate: float = 1.0
    """Factor of the field's learning rates."""
    radiance: RadianceConfig | None
    """None: it has no colours."""
    weights: ShapeWeights
    mesh_cells: int


@dataclass(frozen=True, kw_only=True)
class SdfVolumeConfig(VolumeConfig, ABC):
    """A volume whose shape is a signed distance field."""

    field: FieldConfig
    eikonal_weight: Annotated[float, at_least(0)] = 0.1
    """Factor of the mean squared difference of the field's slope from 1."""

    @property
    def shape(self) -> SdfShape:
        return SdfShape(
            field=self.field,
            radiance=self.radiance,
            weights=ShapeWeights(eikonal=self.eikonal_weight),
            mesh_cells=self.mesh_cells,
        )
