from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.errors import ConfigError
from sculpt_framework.export.pictures import write_maps
from sculpt_framework.export.placing import simplify
from sculpt_framework.export.run_results import read_mesh, read_scene
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.maps.config import MapsExporterConfig


class MapsExporter(Exporter):
    def __init__(self, config: MapsExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        scene, cameras = read_scene(run_dir, self._config.data), self._config.cameras
        mesh = simplify(read_mesh(run_dir), self._config.target_faces)
        views = scene.train if cameras == "train" else scene.test
        if not views:
            raise ConfigError(f"the run has no {cameras} views; choose other --cameras.")
        count = write_maps(out, mesh.vertices, mesh.faces, views)
        return [str(out), f"depth/NAME.tiff and normal/NAME.png for {count} {cameras} views"]
