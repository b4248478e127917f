from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import LossConfig
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    from sculpt_plugins.losses.photometric.loss import Photometric


@dataclass(frozen=True, kw_only=True)
class PhotometricConfig(LossConfig):
    """Colour: (1 - lambda) L1 + lambda D-SSIM (paper, 3.3)."""

    weight: float = 1.0
    """Factor in the outer loss."""
    dssim: Annotated[float, between(0, 1)] = 0.2
    """lambda, the share of D-SSIM (3DGS: 0.2)."""
    light: Literal["one", "per-image"] = "one"
    """per-image: colours are compared after a gain and an offset per image and channel, which are learned: exposure and
    white balance."""
    light_rate: Annotated[float, at_least(0)] = 0.005
    """Learning rate of these."""
    light_prior: Annotated[float, at_least(0)] = 0.01
    """Weight of their mean square: what draws them to gain 1 and offset 0."""

    def build(self) -> "Photometric":
        from sculpt_plugins.losses.photometric.loss import Photometric

        return Photometric(self)
