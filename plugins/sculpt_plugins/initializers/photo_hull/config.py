"""What the silhouettes and the agreement of colours say."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from sculpt_framework.config import InitializerConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.initializers.photo_hull.initializer import PhotoHull


@dataclass(frozen=True, kw_only=True)
class PhotoHullConfig(InitializerConfig):
    """The visual hull, carved where the colours of several views agree on a surface deeper inside."""

    GONE: ClassVar = {"best_of": 3, "ambiguity": 1.5, "margin": 0.7}

    max_views: Annotated[int, at_least(1)] = 100
    """Use at most so many views, spread evenly over the list."""
    cells: Annotated[int, at_least(1)] = 128
    """Cells along the longest side of the object's box in which depths are joined."""
    pixels: Annotated[int, at_least(1)] = 96
    """Pixels along the longest side of the object in the images that are swept."""
    refinements: Annotated[int, at_least(0)] = 1
    """How many times depths are made more exact at twice the resolution."""
    maps: Annotated[int, at_least(1)] = 50
    """Views that get a depth map, spread evenly."""
    depths: Annotated[int, at_least(2)] = 64
    """Depths tried across the object, per pixel."""
    neighbours: Annotated[int, at_least(3)] = 8
    """Views each view is compared with."""
    agreeing: Annotated[int, at_least(0)] = 2
    """Views that must have the same depth for it to be believed."""

    def build(self) -> "PhotoHull":
        from sculpt_plugins.initializers.photo_hull.initializer import PhotoHull

        return PhotoHull(self)
