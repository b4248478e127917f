from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import BackgroundConfig
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.backgrounds.gaussians.background import FreeBackground


@dataclass(frozen=True, kw_only=True)
class GaussiansBackgroundConfig(BackgroundConfig):
    """Free Gaussians, from the points known around the object and on a far shell: whole photographs are compared."""

    around: Annotated[float, between(0, 10)] = 0.1
    """Border of the images around the object, as a share of its longer side: the more, the more of the surroundings is
    learned, and the longer a step takes."""
    near: Annotated[int, at_least(0)] = 12_000
    """Gaussians on points that are known, at most."""
    far: Annotated[int, at_least(1)] = 4_000
    """Gaussians on the far shell."""

    def build(self, device: "torch.device") -> "FreeBackground":
        from sculpt_plugins.backgrounds.gaussians.background import FreeBackground

        return FreeBackground(self, device)
