from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import InitializerConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.initializers.visual_hull.initializer import VisualHull


@dataclass(frozen=True, kw_only=True)
class VisualHullConfig(InitializerConfig):
    """What all masks allow: the largest body with these silhouettes, its far side closed where no view shows it."""

    max_views: Annotated[int, at_least(1)] = 100
    """Use at most so many views, spread evenly over the list."""
    cells: Annotated[int, at_least(0)] = 128
    """Cells along the longest side in which the far side is closed; 0 leaves it the cone that lines of sight make."""

    def build(self) -> "VisualHull":
        from sculpt_plugins.initializers.visual_hull.initializer import VisualHull

        return VisualHull(self)
