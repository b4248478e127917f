"""When a run measures itself, and what it found."""

import math
import statistics
from collections.abc import Sequence
from typing import Any, Literal

_SHARES = (0.25, 0.5)
"""Shares of the run at which a measurement is owed; its end is measured anyway."""
_LATE_SHARES = (0.75, 0.9)
"""The same where steps are counted: no measurement that depends on the clock may choose the state there."""
_COST_AT_MOST = 0.06
"""Of training time so far, for the measurements in between."""
_COST_OF_GIVEN = 0.09
"""Of the time a run is given, where that is known, for all measurements together."""
_AT_END = 2
"""Measurements at the end, of the last state and of the result: their least cost, where drawing is what costs."""
_COST_OF_END = 6
"""The same where a mesh is drawn at once: times what one in between costs, as of the result more is measured."""
_OWED = 3
"""Measurements in between that are owed: of the first surface of a stage, and at two shares."""
_MOST_OF_GIVEN = 0.5
"""The same for those that are owed."""
_FARTHEST = 1 / 12
"""Of the time a run is given: no two measurements are farther apart, if they may be had."""

_WAIT = 10.0
"""Seconds of training before the first measurement where a method begins with no surface."""


class Milestones:
    """Rows of the error-against-time curve: at geometric times (1, 1.4, 2, 2.8, ... s) and fixed shares of the run."""

    def __init__(self, rows: Sequence[dict[str, Any]] = (), given: float | None = None):
        """``given`` is how long the run may take, in seconds, if that is known."""
        self.rows: list[dict[str, Any]] = list(rows)
        self._given = given
        self._farthest = _FARTHEST * given if given else math.inf
        self._shares = _SHARES if given else (*_SHARES, *_LATE_SHARES)
        self._next_second = 1.0
        self._stage_is_new = False
        self._costs: list[float] = []

    def enter_stage(self) -> None:
        """The next surface is the first of its stage, and a measurement of it owed."""
        self._stage_is_new = True

    def wait(self) -> None:
        """What there is at first is not worth measuring."""
        self._next_second = min(self._farthest, _WAIT)

    def charge(self, seconds: float) -> None:
        """A measurement took so long."""
        self._costs.append(seconds)

    def start_due(self) -> bool:
        """Whether what an initializer has made is to be measured: the first is, others if they may be had."""
        return self._given is None or self._affordable(0.0, besides=_OWED)

    def due(self, progress: float, trained: float) -> Literal["stage", "share", "time"] | None:
        """Why a measurement is due now, if one is. ``trained`` is seconds of training.

        The first surface of a stage comes first, then shares: whether one is measured must not depend on how fast the
        machine is.
        """
        if self._stage_is_new:
            self._stage_is_new = False
            if self._bearable:
                return "stage"
        done = self.rows[-1]["progress"] if self.rows else 0.0
        if any(done < share <= progress for share in self._shares) and self._bearable:
            return "share"
        if trained < self._next_second:
            return None
        while self._next_second <= trained:
            self._next_second += min((math.sqrt(2) - 1) * self._next_second, self._farthest)
        return "time" if self._affordable(trained) else None

    @property
    def _bearable(self) -> bool:
        """Whether one more, and those of the end, leave half of a known time to learn in."""
        return self._given is None or self._with_more(1 + _AT_END) <= _MOST_OF_GIVEN * self._given

    def _affordable(self, trained: float, besides: int = 0) -> bool:
        if self._given is None:
            return sum(self._costs) <= _COST_AT_MOST * trained
        return self._with_more(1 + besides + _COST_OF_END) <= _COST_OF_GIVEN * self._given

    def _with_more(self, number: int) -> float:
        """Seconds of all measurements so far, and of so many more."""
        return sum(self._costs) + number * self._usual

    @property
    def seconds_of_end(self) -> float:
        """How long the measurements at the end will take, by those so far."""
        return _AT_END * self._usual

    @property
    def _usual(self) -> float:
        # Not the mean: what there is to start from takes longer, as it is extracted for it, and kernels are loaded.
        # Where surfaces grow, so does what they cost.
        return max(statistics.median(self._costs), self._costs[-1]) if self._costs else 0.0

    def add(self, progress: float, row: dict[str, Any]) -> None:
        self.rows.append({**row, "progress": progress})

    @property
    def staged(self) -> bool:
        """Whether any row is of a stage, not of the start."""
        return any(row["reason"] != "start" for row in self.rows)

    def latest(self, column: str) -> Any:
        return self.rows[-1][column] if self.rows else None

    def of_stage(self, column: str) -> list[tuple[float, float]]:
        """Progress and value of each measurement since the latest stage began, where there is a value."""
        stage = [number for number, row in enumerate(self.rows) if row["reason"] == "stage"]
        rows = self.rows[stage[-1] :] if stage else [row for row in self.rows if row["reason"] != "start"]
        return [(row["progress"], row[column]) for row in rows if row[column] is not None]

    def cut_short(self, factor: float) -> None:
        """The run has become shorter: all progress so far was that much more of it."""
        for row in self.rows:
            row["progress"] *= factor

    def shares(self) -> list[dict[str, Any]]:
        """The first row at or after 25 and 50 % of the run, and the last one if the run came to its end."""
        out = []
        for share, rows in ((0.25, self.rows), (0.5, self.rows), (1.0, self.rows[::-1])):
            row = next((row for row in rows if row["progress"] >= share - 1e-9), None)
            if row is not None:
                out.append({"share": share, "chamfer_ps": row["chamfer_ps"], "psnr": row["psnr"], "iou": row["iou"]})
        return out
