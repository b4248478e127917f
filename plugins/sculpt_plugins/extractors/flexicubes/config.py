"""Options of the ``flexicubes`` extractor."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import ExtractorConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    import torch

    from sculpt_framework.geometry.grid import Grid
    from sculpt_plugins.extractors.flexicubes.extractor import FlexiCubes


@dataclass(frozen=True, kw_only=True)
class FlexiCubesConfig(ExtractorConfig):
    """Dual vertices with learnable weights per cell and, on request, a learnable shift of the grid corners."""

    split: Literal["diagonal", "center"] = "diagonal"
    """How a quad becomes triangles: 2, by the diagonal that leaves the larger smallest angle, or 4 round a centre
    weighted by gamma."""
    learn_weights: bool = True
    """Learn alpha and beta (where a dual vertex lies in its cell) and, with split center, gamma."""
    learn_deformation: bool = False
    """Learn delta, a shift of every grid corner by less than half a cell."""
    damp_grazing: bool = False
    """Lessen the gradient of crossings on edges that the surface grazes, in proportion to how much the distance changes
    along them, in cells. Such a crossing runs far along the surface for a small change of the distance, and would carry
    the noise of the images many times enlarged into the field."""
    weight_rate: Annotated[float, at_least(0)] = 3e-2
    """Learning rate of raw alpha, beta and gamma; the factor in use is 1 + 0.99 tanh(raw)."""
    deformation_rate: Annotated[float, at_least(0)] = 1e-2
    """Learning rate of raw delta; the shift in use is 0.49 tanh(raw) cells along each axis."""

    def build(self, grid: "Grid", device: "torch.device") -> "FlexiCubes":
        import torch

        from sculpt_plugins.extractors.flexicubes.extractor import FlexiCubes

        return FlexiCubes(self, grid, device, torch.get_default_dtype())
