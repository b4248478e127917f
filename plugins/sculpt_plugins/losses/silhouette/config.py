from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from sculpt_framework.config import LossConfig

if TYPE_CHECKING:
    from sculpt_plugins.losses.silhouette.loss import Silhouette


@dataclass(frozen=True, kw_only=True)
class SilhouetteConfig(LossConfig):
    """Coverage against the mask, where the images have one."""

    GONE: ClassVar = {"power": 1.0}

    weight: float = 1.0
    """Factor in the outer loss."""

    def build(self) -> "Silhouette":
        from sculpt_plugins.losses.silhouette.loss import Silhouette

        return Silhouette()
