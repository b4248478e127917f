from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.run_results import result_file
from sculpt_framework.export.saved_gaussians import GAUSSIANS_NAME
from sculpt_framework.exporters import Exporter


class GaussiansExporter(Exporter):
    """The run's own file."""

    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        source = result_file(run_dir, GAUSSIANS_NAME)
        if not (out.exists() and out.samefile(source)):
            write_atomically(out, source.read_bytes())
        return [str(out)]
