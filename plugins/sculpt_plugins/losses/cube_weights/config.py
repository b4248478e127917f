from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import LossConfig

if TYPE_CHECKING:
    from sculpt_plugins.losses.cube_weights.loss import CubeWeights


@dataclass(frozen=True, kw_only=True)
class CubeWeightsConfig(LossConfig):
    """Mean absolute value of the raw FlexiCubes weights."""

    weight: float = 0.01
    """Factor in the outer loss."""

    def build(self) -> "CubeWeights":
        from sculpt_plugins.losses.cube_weights.loss import CubeWeights

        return CubeWeights()
