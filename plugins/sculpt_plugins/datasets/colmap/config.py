from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.posed_images.options import PhotographsConfig

if TYPE_CHECKING:
    from sculpt_plugins.datasets.colmap.dataset import ColmapDataset


@dataclass(frozen=True, kw_only=True)
class ColmapConfig(PhotographsConfig):
    """Photographs in images/ with a sparse model of COLMAP in sparse/0, binary or text."""

    images: str = "images"
    """Folder of the photographs, inside the data folder."""
    model: str = ""
    """Folder of the sparse model, inside the data folder; empty: where COLMAP puts it, the one with most images."""

    def build(self, data: str) -> "ColmapDataset":
        from sculpt_plugins.datasets.colmap.dataset import ColmapDataset

        return ColmapDataset(self, data)
