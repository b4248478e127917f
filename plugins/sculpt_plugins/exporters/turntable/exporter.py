from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sculpt_framework.evaluation.pictures import color_picture
from sculpt_framework.export.baking import bake_texture
from sculpt_framework.export.pictures import paint, turntable_cameras, write_turntable
from sculpt_framework.export.placing import simplify, up_vector
from sculpt_framework.export.run_results import frame_of_run, read_mesh
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.turntable.config import TurntableExporterConfig

_SECONDS = 4
"""What a turn takes, at a rate that players keep."""


class TurntableExporter(Exporter):
    def __init__(self, config: TurntableExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        config = self._config
        mesh = simplify(read_mesh(run_dir), config.target_faces)
        up = up_vector(config.up, frame_of_run(run_dir))
        colors = mesh.shown_colors
        if config.texture:
            colors = bake_texture(mesh, run_dir, config.data, config.texture_size).at(mesh.vertices)
        cameras = turntable_cameras(
            mesh.vertices, np.array([0.0, 0.0, 1.0]) if up is None else up, config.frames, config.size
        )
        pictures = (color_picture(paint(mesh.vertices, mesh.faces, colors, camera)) for camera in cameras)
        write_turntable(out, pictures, max(1, min(30, round(config.frames / _SECONDS))))
        return [str(out)]
