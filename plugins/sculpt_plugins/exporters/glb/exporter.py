from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.export.assets import write_textured_glb
from sculpt_framework.export.baking import bake_texture
from sculpt_framework.export.mesh_files import write_mesh_glb
from sculpt_framework.export.placing import FileFrame, place
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.glb.config import GlbExporterConfig


class GlbExporter(Exporter):
    """glTF prescribes y for up and metres."""

    def __init__(self, config: GlbExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        config = self._config
        mesh = place(run_dir, config, FileFrame(up="y", unit="m"))
        if not config.texture:
            write_mesh_glb(out, mesh.vertices, mesh.faces, mesh.colors)
            return [str(out), *mesh.facts()]
        baked = bake_texture(mesh.world, run_dir, config.data, config.texture_size)
        write_textured_glb(out, baked.at(mesh.vertices))
        return [str(out), *mesh.facts(), baked.said]
