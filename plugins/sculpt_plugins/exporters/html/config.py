from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import ExporterConfig

if TYPE_CHECKING:
    from sculpt_plugins.exporters.html.exporter import HtmlExporter


@dataclass(frozen=True, kw_only=True)
class HtmlExporterConfig(ExporterConfig):
    """A page that plays how the surface came to be, from the steps a viewer recorded, also of a run that has not
    finished."""

    @property
    def file_name(self) -> str:
        return "evolution.html"

    def build(self) -> "HtmlExporter":
        from sculpt_plugins.exporters.html.exporter import HtmlExporter

        return HtmlExporter()
