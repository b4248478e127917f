"""What a run did without, priced by what the run itself measured. Pure functions of its plan and its events."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Facts = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Saving:
    item: str
    what: str
    seconds: float | None
    """By the run's own pace; None where it has no measure for what it never did."""
    megabytes: float | None


def savings(plan: Facts, events: Sequence[Facts]) -> list[Saving]:
    """One for each decision of plan.json that leaves something out, and for what training itself found idle."""
    steps, pace = _inner_pace(events)
    out = []
    for decision in plan.get("decisions") or ():
        spared, seconds = decision.get("spared") or {}, None
        if not decision.get("saves"):
            continue
        if "inner steps per outer step" in spared and pace is not None:
            seconds = spared["inner steps per outer step"] * steps * pace
        ended = _decided(events, decision["item"])
        if decision["item"] == "polish":
            if ended is None:
                continue
            seconds = None if pace is None else ended["spared"] * pace
        megabytes = spared.get("megabytes")
        out.append(Saving(item=decision["item"], what=decision["saves"], seconds=seconds, megabytes=megabytes))
    if (given_up := _decided(events, "sh-degree")) is not None:
        what = f"{given_up['spared']} colour numbers per Gaussian, from the step on that found them idle"
        out.append(Saving(item="sh-degree", what=what, seconds=None, megabytes=given_up["megabytes"]))
    return out


def _inner_pace(events: Sequence[Facts]) -> tuple[int, float | None]:
    """Outer steps of the run, and seconds of one inner step: the median over the steps that were recorded."""
    recorded = [event for event in events if event.get("event") == "outer_step"]
    steps = max((event["outer"] for event in recorded), default=0)
    inner = next(
        (event["data"].get("inner_steps", 0) for event in reversed(events) if event.get("event") == "stage"), 0
    )
    # The first step warms the colours up, with steps of its own.
    took = [event["data"]["inner_s"] for event in recorded if event["outer"] > 1 and "inner_s" in event["data"]]
    return steps, float(np.median(took)) / inner if took and inner else None


def _decided(events: Sequence[Facts], item: str) -> Facts | None:
    """The data of the latest decision about the item that tells how much was spared."""
    told = [event["data"] for event in events if event.get("event") == "decision"]
    return next((data for data in reversed(told) if data.get("item") == item and "spared" in data), None)
