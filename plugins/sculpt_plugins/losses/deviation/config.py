from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import LossConfig

if TYPE_CHECKING:
    from sculpt_plugins.losses.deviation.loss import Deviation


@dataclass(frozen=True, kw_only=True)
class DeviationConfig(LossConfig):
    """FlexiCubes L_dev: dual vertices about equally far from their crossing points."""

    weight: float = 0.02
    """Factor in the outer loss."""

    def build(self) -> "Deviation":
        from sculpt_plugins.losses.deviation.loss import Deviation

        return Deviation()
