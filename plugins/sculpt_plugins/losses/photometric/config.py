from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from sculpt_framework.config import LossConfig

if TYPE_CHECKING:
    from sculpt_plugins.losses.photometric.loss import Photometric


@dataclass(frozen=True, kw_only=True)
class PhotometricConfig(LossConfig):
    """Colour: (1 - lambda) L1 + lambda D-SSIM (paper, 3.3)."""

    weight: float = 1.0
    """Factor in the outer loss."""
    dssim: float = 0.2
    """lambda, the share of D-SSIM (3DGS: 0.2)."""
    light: Literal["one", "per-image"] = "one"
    """per-image: colours are compared after a gain and an offset per image and channel, which are learned: exposure and
    white balance."""
    light_rate: float = 0.005
    """Learning rate of these."""
    light_prior: float = 0.01
    """Weight of their mean square: what draws them to gain 1 and offset 0."""

    def build(self) -> "Photometric":
        from sculpt_plugins.losses.photometric.loss import Photometric

        return Photometric(self)
