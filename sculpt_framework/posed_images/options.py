"""What a user may say about photographs, in every layout that has them. Free of torch, for ``--help``."""

from dataclasses import dataclass
from typing import Literal

from sculpt_framework.config import DatasetConfig

MasksOption = Literal["auto", "cut-out", "none", "ignored"]
InvertMasksOption = Literal["auto", "yes", "no"]
Corners = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class PhotographsConfig(DatasetConfig):
    """Base of the layouts of photographs."""

    downscale: int = 0
    """Read images at 1/N of their width and height; 0: as large as 2 GiB allow for all of them together."""
    masks: MasksOption = "auto"
    """auto: masks that are there, else a plain background keyed out, else found by depth, else cut out by colours;
    cut-out: by colours at once; ignored: as auto where there are no files of masks, whether there are or not."""
    invert_masks: InvertMasksOption = "auto"
    """Whether files of masks are black where the object is; auto looks at their borders and where the cameras look."""
    keep_support: bool = False
    """Leave what the object stands on where masks are found by depth."""
    background: Literal["auto", "white", "black", "none"] = "auto"
    """What is behind images without alpha; auto looks for a constant colour at their borders, none keys nothing."""
    test_every: int = 0
    """Hold every so many views out as test views; 0: as the data say, or learn from all."""
    box: Corners | None = None
    """Two corners of a box that holds the object, in the units and axes of the cameras; found if not given."""
