from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.posed_images.options import PhotographsConfig

if TYPE_CHECKING:
    from sculpt_plugins.datasets.nerfstudio.dataset import NerfstudioDataset


@dataclass(frozen=True, kw_only=True)
class NerfstudioConfig(PhotographsConfig):
    """Photographs with a transforms.json beside them, as nerfstudio and instant-ngp write it."""

    original_frame: bool = False
    """Undo the file's applied_transform and applied_scale, so that the mesh is in the frame before them."""

    def build(self, data: str) -> "NerfstudioDataset":
        from sculpt_plugins.datasets.nerfstudio.dataset import NerfstudioDataset

        return NerfstudioDataset(self, data)
