from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import InitializerConfig

if TYPE_CHECKING:
    from sculpt_plugins.initializers.visual_hull.initializer import VisualHull


@dataclass(frozen=True, kw_only=True)
class VisualHullConfig(InitializerConfig):
    """What all masks allow: the largest body with these silhouettes, its far side closed where no view shows it."""

    max_views: int = 100
    """Use at most so many views, spread evenly over the list."""
    cells: int = 128
    """Cells along the longest side in which the far side is closed; 0 leaves it the cone that lines of sight make."""

    def build(self) -> "VisualHull":
        from sculpt_plugins.initializers.visual_hull.initializer import VisualHull

        return VisualHull(self)
