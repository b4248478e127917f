from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.export.options import DataOption, MeshExporterConfig, UnitOption

if TYPE_CHECKING:
    from sculpt_plugins.exporters.ply.exporter import PlyExporter


@dataclass(frozen=True, kw_only=True)
class PlyExporterConfig(MeshExporterConfig):
    """The mesh with vertex colours, in the scene's frame; z up where --up, --origin or --flat-base is given."""

    unit: UnitOption = None
    """Unit of the file's numbers, for a scene whose size is known, or with --size."""
    attributes: bool = False
    """Also normals, how many photographs show a vertex, and at which angle the best of them does."""
    data: DataOption = None
    """Where the photographs are, if not where the run found them."""

    @property
    def file_name(self) -> str:
        # mesh.ply is the run's own.
        placed = ("placed",) if self.is_placed or self.unit is not None else ()
        return f"{self.stem(*placed, *(('attributes',) if self.attributes else ()))}.ply"

    def build(self) -> "PlyExporter":
        from sculpt_plugins.exporters.ply.exporter import PlyExporter

        self.check()
        return PlyExporter(self)
