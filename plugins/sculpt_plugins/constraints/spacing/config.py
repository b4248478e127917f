from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import ConstraintConfig

if TYPE_CHECKING:
    from sculpt_plugins.constraints.spacing.constraint import Spacing


@dataclass(frozen=True, kw_only=True)
class SpacingConfig(ConstraintConfig):
    """Gaussians of a face keep a distance of 1 / sqrt(K) (paper, eq. 7)."""

    weight: float = 0.01
    """Factor in the inner loss, the lambda_d of the paper."""

    def build(self) -> "Spacing":
        from sculpt_plugins.constraints.spacing.constraint import Spacing

        return Spacing()
