"""What rays through the pixels of all views say."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import InitializerConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.initializers.volume_rendering.initializer import VolumeRendering


@dataclass(frozen=True, kw_only=True)
class VolumeRenderingConfig(InitializerConfig):
    """A hash grid that begins as the visual hull and learns as in NeuS, coarse to fine: for few views, far apart."""

    max_views: Annotated[int, at_least(1)] = 100
    """Use at most so many views, spread evenly over the list."""
    cells: Annotated[int, at_least(8)] = 128
    """Cells along the longest side of the object's box at the end; there are a quarter as many to begin with."""
    steps: Annotated[int, at_least(1)] = 600
    """Steps it learns in."""
    rays: Annotated[int, at_least(1)] = 1024
    """Pixels a step learns from."""

    def build(self) -> "VolumeRendering":
        from sculpt_plugins.initializers.volume_rendering.initializer import VolumeRendering

        return VolumeRendering(self)
