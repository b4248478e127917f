from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from sculpt_framework.config import ExporterConfig
from sculpt_framework.export.options import DataOption, FacesOption

if TYPE_CHECKING:
    from sculpt_plugins.exporters.maps.exporter import MapsExporter


@dataclass(frozen=True, kw_only=True)
class MapsExporterConfig(ExporterConfig):
    """Depths and normals of the mesh from the cameras of the run, a folder."""

    cameras: Literal["train", "test"] = "train"
    """Whose cameras."""
    data: DataOption = None
    """Where the photographs are, if not where the run found them."""
    target_faces: FacesOption = None
    """Simplify the mesh to at most so many faces; it stays closed."""

    @property
    def file_name(self) -> str:
        return "maps"

    def build(self) -> "MapsExporter":
        from sculpt_plugins.exporters.maps.exporter import MapsExporter

        return MapsExporter(self)
