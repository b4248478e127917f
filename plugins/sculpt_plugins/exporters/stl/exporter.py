from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.stl import export_stl

from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.placing import FileFrame, place
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.stl.config import StlExporterConfig


class StlExporter(Exporter):
    def __init__(self, config: StlExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        mesh = place(run_dir, self._config, FileFrame(up="z", unit="mm", needs_size=True), self._config.unit)
        # Rounded before, so that the normals are of the triangles that are written.
        shape = trimesh.Trimesh(mesh.vertices.astype(np.float32), mesh.faces, process=False)
        write_atomically(out, export_stl(shape))
        return [str(out), *mesh.facts()]
