from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.export.options import MeshExporterConfig, UnitOption

if TYPE_CHECKING:
    from sculpt_plugins.exporters.three_mf.exporter import ThreeMfExporter


@dataclass(frozen=True, kw_only=True)
class ThreeMfExporterConfig(MeshExporterConfig):
    """The mesh with vertex colours, z up, with its unit: for 3D printing."""

    unit: UnitOption = None
    """Unit of the numbers, which the file says too. Default: mm."""

    @property
    def file_name(self) -> str:
        return f"{self.stem()}.3mf"

    def build(self) -> "ThreeMfExporter":
        from sculpt_plugins.exporters.three_mf.exporter import ThreeMfExporter

        self.check()
        return ThreeMfExporter(self)
