from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ConstraintConfig
from sculpt_framework.ranges import between

if TYPE_CHECKING:
    from sculpt_plugins.constraints.coverage.constraint import Coverage


@dataclass(frozen=True, kw_only=True)
class CoverageConfig(ConstraintConfig):
    """Gaussians of a face span its barycentric domain (paper, eq. 9)."""

    weight: float = 0.01
    """Factor in the inner loss, the lambda_c of the paper."""
    threshold: Annotated[float, between(0, 1)] = 0.8
    """Range every barycentric coordinate should reach (paper: 0.8)."""

    def build(self) -> "Coverage":
        from sculpt_plugins.constraints.coverage.constraint import Coverage

        return Coverage(self.threshold)
