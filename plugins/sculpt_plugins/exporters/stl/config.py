from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.export.options import MeshExporterConfig, UnitOption

if TYPE_CHECKING:
    from sculpt_plugins.exporters.stl.exporter import StlExporter


@dataclass(frozen=True, kw_only=True)
class StlExporterConfig(MeshExporterConfig):
    """The mesh without colours, binary, z up, in millimetres: for 3D printing."""

    unit: UnitOption = None
    """Unit of the numbers; the file does not say it. Default: mm, which slicers take it for."""

    @property
    def file_name(self) -> str:
        return f"{self.stem()}.stl"

    def build(self) -> "StlExporter":
        from sculpt_plugins.exporters.stl.exporter import StlExporter

        self.check()
        return StlExporter(self)
