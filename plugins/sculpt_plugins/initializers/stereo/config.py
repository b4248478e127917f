"""What the silhouettes and depth maps of all views say."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import InitializerConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.initializers.stereo.initializer import Stereo


@dataclass(frozen=True, kw_only=True)
class StereoConfig(InitializerConfig):
    """Depth maps of all views by PatchMatch stereo, joined within the visual hull."""

    max_views: Annotated[int, at_least(1)] = 100
    """Use at most so many views, spread evenly over the list."""
    cells: Annotated[int, at_least(1)] = 128
    """Cells along the longest side of the object's box in which depths are joined."""
    pixels: Annotated[int, at_least(1)] = 384
    """Pixels along the longest side of the object in the finest images that are compared."""
    neighbours: Annotated[int, at_least(1)] = 8
    """Views each view is compared with."""
    agreeing: Annotated[int, at_least(0)] = 2
    """Views that must have the same depth for it to be believed."""

    def build(self) -> "Stereo":
        from sculpt_plugins.initializers.stereo.initializer import Stereo

        return Stereo(self)
