from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.export.options import TexturedExporterConfig

if TYPE_CHECKING:
    from sculpt_plugins.exporters.glb.exporter import GlbExporter


@dataclass(frozen=True, kw_only=True)
class GlbExporterConfig(TexturedExporterConfig):
    """The mesh with vertex colours or a texture, y up, in metres where the scene's size is known: for game engines,
    Blender and the web."""

    @property
    def file_name(self) -> str:
        # mesh.glb is the run's own, which is not turned.
        stem = self.textured_stem
        return f"{'mesh-y-up' if stem == 'mesh' else stem}.glb"

    def build(self) -> "GlbExporter":
        from sculpt_plugins.exporters.glb.exporter import GlbExporter

        self.check()
        return GlbExporter(self)
