from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import LossConfig
from sculpt_framework.ranges import above

if TYPE_CHECKING:
    from sculpt_plugins.losses.silhouette.loss import Silhouette


@dataclass(frozen=True, kw_only=True)
class SilhouetteConfig(LossConfig):
    """Coverage against the mask, where the images have one."""

    weight: float = 1.0
    """Factor in the outer loss."""
    power: Annotated[float, above(0)] = 1.0
    """1: mean absolute difference, 2: mean squared difference."""

    def build(self) -> "Silhouette":
        from sculpt_plugins.losses.silhouette.loss import Silhouette

        return Silhouette(self.power)
