from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.posed_images.options import PhotographsConfig

if TYPE_CHECKING:
    from sculpt_plugins.datasets.idr.dataset import IdrDataset


@dataclass(frozen=True, kw_only=True)
class IdrConfig(PhotographsConfig):
    """Photographs in image/, masks in mask/, projection matrices in cameras.npz or cameras_sphere.npz."""

    def build(self, data: str) -> "IdrDataset":
        from sculpt_plugins.datasets.idr.dataset import IdrDataset

        return IdrDataset(self, data)
