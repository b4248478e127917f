"""Options of ``volsdf``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.ranges import above, at_least
from sculpt_framework.volume_rendering.config import SdfVolumeConfig

if TYPE_CHECKING:
    from sculpt_plugins.methods.volsdf.volume import VolsdfVolume


@dataclass(frozen=True, kw_only=True)
class VolsdfConfig(SdfVolumeConfig):
    """VolSDF (Yariv et al. 2021): density from the cumulative Laplace distribution of the distance."""

    beta: Annotated[float, above(0)] = 0.1
    """Width of that distribution, to begin with, in object units. It is learned."""
    beta_rate: Annotated[float, at_least(0)] = 1e-3
    """Learning rate of its logarithm."""
    least_beta: Annotated[float, above(0)] = 1e-4
    """What is added to it (program, ``code/confs/dtu.conf``)."""

    def build_volume(self) -> "VolsdfVolume":
        from sculpt_plugins.methods.volsdf.volume import VolsdfVolume

        return VolsdfVolume(self)
