"""What a rule of the plan is, and what it says."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from sculpt_framework.plan.evidence import Evidence
from sculpt_framework.sculpting.config import SculptingConfig


@dataclass(frozen=True, kw_only=True)
class Ruling:
    """What a rule would do."""

    config: SculptingConfig
    """As it is to be; equal to what was given where nothing is left out."""
    value: str
    evidence: str
    measured: Mapping[str, float] = field(default_factory=dict)
    saves: str | None = None
    spared: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Rule:
    item: str
    """Field of PlanConfig."""
    touches: Sequence[str]
    """What of the config it may change; if the user has set any of it, the item is the user's."""
    decide: Callable[[SculptingConfig, Evidence], Ruling]
