"""What the plan decided, why, and the file that keeps it. Free of torch."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.json_text import json_text

PLAN_NAME = "plan.json"
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Decision:
    """One item that was looked at."""

    item: str
    """As in ``--plan.ITEM``, with dashes."""
    value: str
    """What is done."""
    evidence: str
    """Why, with the number."""
    measured: Mapping[str, float] = field(default_factory=dict)
    """The numbers of the evidence."""
    saves: str | None = None
    """What the run does without; None where nothing is left out."""
    spared: Mapping[str, float] = field(default_factory=dict)
    """That in units a run can price at its end: inner_steps, binds, megabytes and so on."""

    @property
    def override(self) -> str:
        """The option that takes the decision back."""
        return f"--plan.{self.item} off"


@dataclass(frozen=True, kw_only=True)
class ScenePlan:
    """All decisions of a run."""

    decisions: Sequence[Decision]
    """What changes the run."""
    kept: Sequence[Decision]
    """What was looked at and stays as the method or the user has it."""
    seconds: float
    """What looking took."""

    def values(self) -> dict[str, Any]:
        """As JSON values: the file, and the data of the event "plan"."""

        def row(decision: Decision) -> dict[str, Any]:
            return {**asdict(decision), "override": decision.override}

        return {
            "version": VERSION,
            "seconds": self.seconds,
            "decisions": [row(decision) for decision in self.decisions],
            "kept": [row(decision) for decision in self.kept],
        }


def write_plan(plan: ScenePlan, folder: Path) -> None:
    """Write FOLDER/plan.json. Raises OutputError."""
    write_atomically(folder / PLAN_NAME, (json_text(plan.values(), indent=2) + "\n").encode("utf-8"))
