from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import LossConfig
from sculpt_framework.ranges import at_least, require

if TYPE_CHECKING:
    from sculpt_plugins.losses.consistency.loss import Consistency


@dataclass(frozen=True, kw_only=True)
class ConsistencyConfig(LossConfig):
    """1 - normalised correlation of neighbouring photographs laid into each other through the surface."""

    weight: float = 1.0
    """Factor in the outer loss."""
    views: Annotated[int, at_least(1)] = 4
    """Photographs looked at in an outer step."""
    partners: Annotated[int, at_least(1)] = 2
    """Neighbours each of them is compared with."""
    window: Annotated[int, at_least(3)] = 7
    """Pixels along the sides of the windows that are correlated, an odd number."""

    def check(self, option: str) -> None:
        require(self.window % 2 == 1, f"{option}.window", self.window, "an odd number")

    def build(self) -> "Consistency":
        from sculpt_plugins.losses.consistency.loss import Consistency

        return Consistency(self)
