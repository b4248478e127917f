from dataclasses import dataclass
from typing import TYPE_CHECKING

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

    def build(self) -> "Photometric":
        from sculpt_plugins.losses.photometric.loss import Photometric

        return Photometric(self.dssim)
