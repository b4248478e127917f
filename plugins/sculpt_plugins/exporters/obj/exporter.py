from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.export.assets import check_textured_obj, write_textured_obj
from sculpt_framework.export.baking import bake_texture
from sculpt_framework.export.mesh_files import write_mesh_obj
from sculpt_framework.export.placing import FileFrame, place
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.obj.config import ObjExporterConfig


class ObjExporter(Exporter):
    def __init__(self, config: ObjExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        config = self._config
        if config.texture:
            # Baking takes its time.
            check_textured_obj(out)
        mesh = place(run_dir, config, FileFrame(up="y"), config.unit)
        if not config.texture:
            write_mesh_obj(out, mesh.vertices, mesh.faces, mesh.colors)
            return [str(out), *mesh.facts()]
        baked = bake_texture(mesh.world, run_dir, config.data, config.texture_size)
        paths = write_textured_obj(out, baked.at(mesh.vertices))
        return [*map(str, paths), *mesh.facts(), baked.said]
