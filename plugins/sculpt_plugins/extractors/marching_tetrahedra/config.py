"""Options of the ``marching-tetrahedra`` extractor."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import ExtractorConfig

if TYPE_CHECKING:
    import torch

    from sculpt_framework.geometry.grid import Grid
    from sculpt_plugins.extractors.marching_tetrahedra.extractor import MarchingTetrahedra


@dataclass(frozen=True, kw_only=True)
class MarchingTetrahedraConfig(ExtractorConfig):
    """Six tetrahedra per cell, nothing to learn. About three times the faces of ``flexicubes`` on the same grid."""

    def build(self, grid: "Grid", device: "torch.device") -> "MarchingTetrahedra":
        import torch

        from sculpt_plugins.extractors.marching_tetrahedra.extractor import MarchingTetrahedra

        return MarchingTetrahedra(grid, torch.get_default_dtype())
