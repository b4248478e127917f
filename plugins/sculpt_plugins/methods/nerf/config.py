"""Options of ``nerf``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.ranges import at_least
from sculpt_framework.volume_rendering.config import VolumeConfig

if TYPE_CHECKING:
    from sculpt_plugins.methods.nerf.volume import NerfVolume


@dataclass(frozen=True, kw_only=True)
class NerfConfig(VolumeConfig):
    """NeRF (Mildenhall et al. 2020), on a hash grid: density and colour; a mesh by a threshold of the density."""

    features: Annotated[int, at_least(1)] = 15
    """Numbers that the density's decoder hands to that of the colour."""

    def build_volume(self) -> "NerfVolume":
        from sculpt_plugins.methods.nerf.volume import NerfVolume

        return NerfVolume(self)
