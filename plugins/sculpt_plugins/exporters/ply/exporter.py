from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.export.assets import write_attribute_ply
from sculpt_framework.export.mesh_files import vertex_normals, write_mesh_ply
from sculpt_framework.export.mesh_pixels import visibility
from sculpt_framework.export.placing import FileFrame, PlacedMesh, place
from sculpt_framework.export.run_results import read_scene
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.ply.config import PlyExporterConfig


class PlyExporter(Exporter):
    def __init__(self, config: PlyExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        mesh = place(run_dir, self._config, FileFrame(up="z", turned=False), self._config.unit)
        if self._config.attributes:
            return [str(out), *mesh.facts(), self._write_attributes(mesh, run_dir, out)]
        write_mesh_ply(out, mesh.vertices, mesh.faces, mesh.colors)
        return [str(out), *mesh.facts()]

    def _write_attributes(self, mesh: PlacedMesh, run_dir: Path, out: Path) -> str:
        cameras = [view.camera for view in read_scene(run_dir, self._config.data).train]
        world = mesh.world
        normals = vertex_normals(world.vertices, world.faces)
        seen = visibility(world.vertices, world.faces, normals, cameras)
        write_attribute_ply(out, mesh.vertices, mesh.faces, world.shown_colors, seen)
        unseen = int((seen.times_seen == 0).sum())
        return f"{unseen} of {len(mesh.vertices)} vertices are in no photograph: times_seen is 0 there"
