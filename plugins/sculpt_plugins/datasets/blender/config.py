from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import DatasetConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.datasets.blender.dataset import BlenderDataset


@dataclass(frozen=True, kw_only=True)
class BlenderConfig(DatasetConfig):
    """A folder in NeRF-Synthetic layout: transforms_train.json, optionally _test and _val, and images."""

    background: Literal["auto", "white", "black", "none"] = "auto"
    """What is behind images without alpha; auto looks for a constant colour at their borders, none keys nothing."""
    downscale: Annotated[int, at_least(0)] = 1
    """Read images at 1/N of their width and height; 0: as large as 2 GiB allow for all of them together."""

    def build(self, data: str) -> "BlenderDataset":
        from sculpt_plugins.datasets.blender.dataset import BlenderDataset

        return BlenderDataset(self, data)
