"""Options of ``neus``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.ranges import above, at_least
from sculpt_framework.volume_rendering.config import SdfVolumeConfig

if TYPE_CHECKING:
    from sculpt_framework.volume_rendering.logistic import LogisticVolume


@dataclass(frozen=True, kw_only=True)
class NeusConfig(SdfVolumeConfig):
    """NeuS (Wang et al. 2021): opacity from how far a logistic function of the distance falls along a stretch."""

    sharpness: Annotated[float, above(0)] = 20.0
    """Of the logistic function, to begin with, per object unit: the paper's s. It is learned."""
    sharpness_rate: Annotated[float, at_least(0)] = 1e-3
    """Learning rate of a tenth of its logarithm."""

    def build_volume(self) -> "LogisticVolume":
        from sculpt_framework.volume_rendering.logistic import LogisticVolume

        return LogisticVolume(self.shape, self.sharpness, self.sharpness_rate)
