from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.errors import ConfigError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.gaussian_files import joined, read_gaussians_ply, write_gaussians_ply
from sculpt_framework.export.run_results import result_file
from sculpt_framework.export.saved_gaussians import BACKGROUND_NAME, GAUSSIANS_NAME
from sculpt_framework.exporters import Exporter
from sculpt_plugins.exporters.gaussians.config import GaussiansExporterConfig


class GaussiansExporter(Exporter):
    """The run's own file, or that with the one of its background."""

    def __init__(self, config: GaussiansExporterConfig):
        self._config = config

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        source = result_file(run_dir, GAUSSIANS_NAME)
        onto_itself = out.exists() and out.samefile(source)
        if not self._config.background:
            if not onto_itself:
                write_atomically(out, source.read_bytes())
            return [str(out)]
        if onto_itself:
            raise ConfigError(f"--out {out} is the run's own file, of the object alone; choose another name.")
        behind = run_dir / BACKGROUND_NAME
        if not behind.is_file():
            raise ConfigError(
                f"--background: {run_dir} has no {BACKGROUND_NAME}; train with --background gaussians to have one."
            )
        write_gaussians_ply(out, joined(read_gaussians_ply(source), read_gaussians_ply(behind)))
        return [str(out)]
