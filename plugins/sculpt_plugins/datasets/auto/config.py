"""Recognises what ``--data`` names and hands it to the dataset that reads it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import DatasetConfig
from sculpt_framework.posed_images.options import Corners, InvertMasksOption, MasksOption, check_box
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.datasets.auto.dataset import AutoDataset


@dataclass(frozen=True, kw_only=True)
class AutoDatasetConfig(DatasetConfig):
    """Recognises demo names and folder layouts; name a layout with --dataset to set its other options."""

    downscale: Annotated[int | None, at_least(0)] = None
    """Read images at 1/N of their width and height; 0: as the memory allows; None: as the layout does by itself."""
    masks: MasksOption | None = None
    """Of layouts of photographs: what their own --dataset.masks says; None: as the layout does by itself."""
    invert_masks: InvertMasksOption = "auto"
    """Of layouts of photographs: whether files of masks are black where the object is; auto looks at them."""
    keep_support: bool = False
    """Of layouts of photographs: leave what the object stands on where masks are found by depth."""
    box: Corners | None = None
    """Of layouts of photographs: two corners of a box that holds the object, in the cameras' units."""

    def check(self, option: str) -> None:
        check_box(self.box, option)

    def build(self, data: str) -> "AutoDataset":
        from sculpt_plugins.datasets.auto.dataset import AutoDataset

        return AutoDataset(self, data)
