"""What a user may say about photographs, in every layout that has them. Free of torch, for ``--help``."""

from dataclasses import dataclass
from typing import Annotated, Literal

from sculpt_framework.config import DatasetConfig
from sculpt_framework.ranges import at_least, require

MasksOption = Literal["auto", "cut-out", "none", "ignored"]
InvertMasksOption = Literal["auto", "yes", "no"]
Corners = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class PhotographsConfig(DatasetConfig):
    """Base of the layouts of photographs."""

    downscale: Annotated[int, at_least(0)] = 0
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
    test_every: Annotated[int, at_least(2, or_zero=True)] = 0
    """Hold every so many views out as test views; 0: as the data say, or learn from all."""
    box: Corners | None = None
    """Two corners of a box that holds the object, in the units and axes of the cameras; found if not given."""

    def check(self, option: str) -> None:
        check_box(self.box, option)


def check_box(box: Corners | None, option: str) -> None:
    """Raise ConfigError for a box without room inside. ``option`` is the dataset's."""
    if box is not None:
        given = " ".join(f"{number:g}" for number in box)
        holds = all(low < high for low, high in zip(box[:3], box[3:], strict=True))
        require(holds, f"{option}.box", given, "X0 Y0 Z0 X1 Y1 Z1 with each first number below the second")
