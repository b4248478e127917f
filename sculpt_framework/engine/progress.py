"""Where a run stands, and the state that goes with it where it is saved."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from sculpt_framework.parameters import state_below

_BEST = "best/"


@dataclass(frozen=True, kw_only=True)
class Progress:
    """With the method's state, all that resuming needs."""

    outer: int
    """Steps taken."""
    progress: float
    """Share of the run that is done."""
    trained_seconds: float
    best_psnr: float | None
    """Of the best state, whose tensors are saved beside the latest."""
    rate_scale: float
    recoveries: int
    milestones: list[dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Where a session stands after its start, and after each step."""

    step: int
    """Steps taken; 0 right after the start."""
    progress: float
    """Share of the run that is done."""
    loss: float | None
    """Of this step; None after the start, and after a step that failed and was taken back."""
    terms: Mapping[str, float]


Saved = tuple[Mapping[str, Tensor], Progress]
"""A checkpoint: the latest state with the best one (``with_best``), and where the run stood."""


def with_best(latest: Mapping[str, Tensor], best: Mapping[str, Tensor] | None) -> dict[str, Tensor]:
    """Two states as one, to be saved in one file: they must never be of different ages."""
    return {**latest, **{f"{_BEST}{name}": value for name, value in (best or {}).items()}}


def split_best(state: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Inverse of ``with_best``; the second is empty where there was none."""
    latest = {name: value for name, value in state.items() if not name.startswith(_BEST)}
    best = state_below(state, _BEST)
    return latest, best
