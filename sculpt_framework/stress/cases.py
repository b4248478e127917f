"""A case of the suite and its result."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from sculpt_framework.errors import first_line

Group = Literal["operators", "life", "stiff", "scenes", "guard"]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What a case found."""

    value: float
    """The figure that is held against the limit; not finite: it failed whatever the limit."""
    note: str = ""
    """What else is worth telling, in one line."""
    float32_error: float | None = None
    """Largest relative difference of value or gradient between float32 and float64; None where there is no pair."""
    curve: tuple[str, float, float] | None = None
    """Of a point on a curve: the curve's name, the parameter, the error there."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """Something to try and what should come of it."""

    id: str
    """Words joined by hyphens, distinct in the suite."""
    group: Group
    done: str
    expected: str
    unit: str
    limit: float
    """The figure must not exceed it."""
    measure: Callable[[], Measured]
    at_least: bool = False
    """The figure must not fall below the limit instead."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A case that was tried."""

    id: str
    group: Group
    done: str
    expected: str
    measured: float
    unit: str
    limit: float
    at_least: bool
    ok: bool
    float32_error: float | None
    note: str
    seconds: float
    curve: tuple[str, float, float] | None = None

    def as_json(self) -> Mapping[str, Any]:
        """A row of ``sculpt-stress --json``."""
        return asdict(self)


def run_cases(cases: Iterable[Case]) -> Iterator[Result]:
    """Try them in turn. Whatever one raises is its result, and the others are still tried."""
    for case in cases:
        began = time.perf_counter()
        try:
            found = case.measure()
        except Exception as error:  # A case that cannot be measured has failed; the suite goes on.
            message = first_line(error)
            found = Measured(value=math.inf, note=f"raised {message}")
        yield Result(
            id=case.id,
            group=case.group,
            done=case.done,
            expected=case.expected,
            measured=found.value,
            unit=case.unit,
            limit=case.limit,
            at_least=case.at_least,
            ok=math.isfinite(found.value)
            and (found.value >= case.limit if case.at_least else found.value <= case.limit),
            float32_error=found.float32_error,
            note=found.note,
            seconds=round(time.perf_counter() - began, 3),
            curve=found.curve,
        )
