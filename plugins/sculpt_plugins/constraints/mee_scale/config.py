from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import ConstraintConfig
from sculpt_framework.ranges import above

if TYPE_CHECKING:
    from sculpt_plugins.constraints.mee_scale.constraint import MeeScale


@dataclass(frozen=True, kw_only=True)
class MeeScaleConfig(ConstraintConfig):
    """Gaussians stay inside an ellipse of their face."""

    weight: float = 1.0
    """Factor in the inner loss."""
    form: Literal["steiner", "edges"] = "steiner"
    """The Steiner circumellipse, or the diagonal of half edges of the paper."""
    limit: Annotated[float, above(0)] = 1.0
    """Largest allowed eigenvalue of the covariance relative to the ellipse (paper: 1)."""

    def build(self) -> "MeeScale":
        from sculpt_plugins.constraints.mee_scale.constraint import MeeScale

        return MeeScale(self.form, self.limit)
