"""What training tells: a stream of events. Whoever cares subscribes; the trainer never knows who listens."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

EventName = Literal[
    "plan",
    "run_started",
    "stage",
    "outer_step",
    "snapshot",
    "evaluation",
    "decision",
    "action",
    "warning",
    "recovered",
    "checkpoint",
    "run_ended",
]


@dataclass(frozen=True, kw_only=True)
class Event:
    """One thing that happened.

    ``t_train`` are seconds of training alone (evaluation, saving and viewing excluded), ``t_wall`` seconds since the
    process started; ``outer`` counts outer steps. ``data`` holds JSON values, except in "snapshot" events, which carry
    read-only arrays of the current surface for viewers and are not recorded.
    """

    t_train: float
    t_wall: float
    outer: int
    event: EventName
    data: Mapping[str, Any]
