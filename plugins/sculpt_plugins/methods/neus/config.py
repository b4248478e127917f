"""Options of ``neus``."""

from dataclasses import dataclass

from sculpt_framework.volume_rendering.config import LogisticVolumeConfig


@dataclass(frozen=True, kw_only=True)
class NeusConfig(LogisticVolumeConfig):
    """NeuS (Wang et al. 2021): opacity from how far a logistic function of the distance falls along a stretch."""
