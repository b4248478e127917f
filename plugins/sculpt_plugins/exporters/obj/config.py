from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.export.options import TexturedExporterConfig, UnitOption

if TYPE_CHECKING:
    from sculpt_plugins.exporters.obj.exporter import ObjExporter


@dataclass(frozen=True, kw_only=True)
class ObjExporterConfig(TexturedExporterConfig):
    """The mesh with vertex colours or a texture, y up."""

    unit: UnitOption = None
    """Unit of the file's numbers, for a scene whose size is known, or with --size."""

    @property
    def file_name(self) -> str:
        return f"{self.textured_stem}.obj"

    def build(self) -> "ObjExporter":
        from sculpt_plugins.exporters.obj.exporter import ObjExporter

        self.check()
        return ObjExporter(self)
