from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import ExporterConfig

if TYPE_CHECKING:
    from sculpt_plugins.exporters.gaussians.exporter import GaussiansExporter


@dataclass(frozen=True, kw_only=True)
class GaussiansExporterConfig(ExporterConfig):
    """The Gaussians as PLY in the layout of 3DGS, in the scene's frame: for splat viewers."""

    @property
    def file_name(self) -> str:
        return "gaussians.ply"

    def build(self) -> "GaussiansExporter":
        from sculpt_plugins.exporters.gaussians.exporter import GaussiansExporter

        return GaussiansExporter()
