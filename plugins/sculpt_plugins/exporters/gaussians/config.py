"""The Gaussians as 3DGS writes them."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import ExporterConfig

if TYPE_CHECKING:
    from sculpt_plugins.exporters.gaussians.exporter import GaussiansExporter


@dataclass(frozen=True, kw_only=True)
class GaussiansExporterConfig(ExporterConfig):
    """The Gaussians as PLY in the layout of 3DGS, in the scene's frame: for splat viewers."""

    background: bool = False
    """With what is around the object, of a run with --background gaussians."""

    @property
    def file_name(self) -> str:
        return "gaussians-whole.ply" if self.background else "gaussians.ply"

    def build(self) -> "GaussiansExporter":
        from sculpt_plugins.exporters.gaussians.exporter import GaussiansExporter

        return GaussiansExporter(self)
