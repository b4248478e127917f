from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.exporters import Exporter
from sculpt_framework.viewing.html import write_html


class HtmlExporter(Exporter):
    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        if write_html(run_dir, out) > 1:
            return [str(out)]
        return [str(out), "note: one state only; a run with --viewer records the steps on its way."]
