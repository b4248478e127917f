from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import DatasetConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.datasets.omniobject3d.dataset import OmniObject3DDataset


@dataclass(frozen=True, kw_only=True)
class OmniObject3DConfig(DatasetConfig):
    """An object of OmniObject3D: blender_renders/CATEGORY/OBJECT, with its scan in raw_scans beside."""

    background: Literal["auto", "white", "black", "none"] = "auto"
    """What is behind images without alpha; auto looks for a constant colour at their borders, none keys nothing."""
    downscale: Annotated[int, at_least(0)] = 1
    """Read images at 1/N of their width and height; 0: as large as 2 GiB allow for all of them together."""
    test_every: Annotated[int, at_least(2, or_zero=True)] = 0
    """Hold every so many views out as test views; 0: learn from all. The dataset has no split of its own."""

    def build(self, data: str) -> "OmniObject3DDataset":
        from sculpt_plugins.datasets.omniobject3d.dataset import OmniObject3DDataset

        return OmniObject3DDataset(self, data)
