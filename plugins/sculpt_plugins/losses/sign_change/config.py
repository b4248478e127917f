from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import LossConfig
from sculpt_framework.ranges import above

if TYPE_CHECKING:
    from sculpt_plugins.losses.sign_change.loss import SignChange


@dataclass(frozen=True, kw_only=True)
class SignChangeConfig(LossConfig):
    """Cross-entropy of the signs at crossed edges: against floaters and bubbles inside."""

    weight: float = 0.01
    """Factor in the outer loss."""
    sharpness: Annotated[float, above(0)] = 20.0
    """Logits per object unit of distance."""

    def build(self) -> "SignChange":
        from sculpt_plugins.losses.sign_change.loss import SignChange

        return SignChange(self.sharpness)
