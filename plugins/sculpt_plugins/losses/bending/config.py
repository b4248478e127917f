from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import LossConfig
from sculpt_framework.ranges import above

if TYPE_CHECKING:
    from sculpt_plugins.losses.bending.loss import Bending


@dataclass(frozen=True, kw_only=True)
class BendingConfig(LossConfig):
    """Angles between neighbouring faces: small ones are smoothed away, creases stay."""

    weight: float = 0.06
    """Factor in the outer loss."""
    crease: Annotated[float, above(0, at_most=180)] = 30.0
    """Degrees between two normals at which half of what an edge can cost is reached."""

    def build(self) -> "Bending":
        from sculpt_plugins.losses.bending.loss import Bending

        return Bending(self.crease)
