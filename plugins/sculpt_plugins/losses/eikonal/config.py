from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import LossConfig

if TYPE_CHECKING:
    from sculpt_plugins.losses.eikonal.loss import Eikonal


@dataclass(frozen=True, kw_only=True)
class EikonalConfig(LossConfig):
    """Gradient of norm one in the cells the surface passes through."""

    weight: float = 0.01
    """Factor in the outer loss."""

    def build(self) -> "Eikonal":
        from sculpt_plugins.losses.eikonal.loss import Eikonal

        return Eikonal()
