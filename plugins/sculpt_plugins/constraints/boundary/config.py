from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ConstraintConfig
from sculpt_framework.ranges import above

if TYPE_CHECKING:
    from sculpt_plugins.constraints.boundary.constraint import Boundary


@dataclass(frozen=True, kw_only=True)
class BoundaryConfig(ConstraintConfig):
    """Gaussians keep away from the edges of their face (paper, eq. 6)."""

    weight: float = 0.01
    """Factor in the inner loss, the lambda_b of the paper."""
    steepness: Annotated[float, above(0)] = 10.0
    """Factor in the exponent (paper: 10)."""

    def build(self) -> "Boundary":
        from sculpt_plugins.constraints.boundary.constraint import Boundary

        return Boundary(self.steepness)
