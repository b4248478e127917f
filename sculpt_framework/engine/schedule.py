"""Where a run stands: progress from 0 to 1, the stage it is in, and what follows from that."""

import math
import time
from collections.abc import Sequence

from scipy.special import lambertw

from sculpt_framework.config import StageConfig, TrainerConfig

_LEFT = 0.2
"""Of a run that is cut short: its rates fall to the end within it."""
_WARM = 0.25
"""Of the time given: before the surface first moves, colours learn for no more of it."""


class Schedule:
    """Progress by outer steps, or, if a deadline is given, by the clock.

    With a deadline the number of steps follows from the machine's speed, so runs are not repeatable bit by bit; without
    one they are.
    """

    def __init__(self, config: TrainerConfig, deadline: float | None):
        """``deadline`` is a ``time.monotonic()`` instant at which optimisation has to end."""
        timed = deadline is not None
        shares = [
            stage.time_share if timed and stage.time_share is not None else stage.share for stage in config.stages
        ]
        if not shares or min(shares) <= 0:
            raise ValueError("a schedule needs stages with positive shares")
        total = sum(shares)
        self._ends = [sum(shares[: index + 1]) / total for index in range(len(shares))]
        self._stages: Sequence[StageConfig] = config.stages
        self._steps = config.outer_steps
        self._final_rate = config.final_rate
        self._full_steps = config.surface_steps
        self._deadline = deadline
        self._began: float | None = None
        self._done_before = 0.0

    @property
    def total_steps(self) -> int | None:
        return None if self._deadline is not None else self._steps

    def begin(self, done: float = 0.0) -> None:
        """Optimisation starts now; a share ``done`` of it has been done before, in the run that is gone on with.

        The start must be made by then: rates that fall while nothing is optimised are too low for what comes after.
        """
        self._began = time.monotonic()
        self._done_before = done

    def progress(self, outer: int) -> float:
        """Share of the run that is done after ``outer`` outer steps, at most 1."""
        if self._deadline is None:
            return min(1.0, outer / max(1, self._steps))
        if self._began is None:
            return self._done_before
        span = self._deadline - self._began
        return 1.0 if span <= 0 else min(1.0, self._done_before + (time.monotonic() - self._began) / span)

    def warm(self) -> bool:
        """Whether colours have had the time there is for them before the first outer step."""
        return self._deadline is not None and self.progress(0) >= _WARM

    def cut_short(self) -> float | None:
        """Have a fifth of the run left: what it is from now on, by what it was. None if no more is left anyway.

        The rates become those that a run of the new length has at this moment. What was progress before is that times
        the figure returned. Runs that count steps are not cut.
        """
        progress = self.progress(0)
        if self._deadline is None or self._began is None or not 0 < progress < 1 - _LEFT:
            return None
        factor = (1 - _LEFT) / progress
        span = (self._deadline - self._began) / factor
        self.begin(1 - _LEFT)
        self._deadline = self._began + span
        return factor

    def stage_index(self, progress: float) -> int:
        for index, end in enumerate(self._ends):
            if progress < end - 1e-9:
                return index
        return len(self._ends) - 1

    def stage(self, progress: float) -> StageConfig:
        return self._stages[self.stage_index(progress)]

    def rate_factor(self, progress: float) -> float:
        """Factor on learning rates: they fall exponentially to ``final_rate``."""
        return self._final_rate**progress

    def surface_rate(self, rate: float, outer: int) -> float:
        """What of a factor on learning rates the surface gets after so many outer steps of this run."""
        progress = self.progress(outer)
        if self._full_steps == 0 or outer == 0 or progress == 0:
            return rate
        return min(rate, 1.0 / (1.0 + progress * settling(outer / progress, self._full_steps)))


def settling(steps: float, full: float) -> float:
    """The x for which 1 / (1 + x p), over ``steps`` steps with p going from 0 to 1, adds up to ``full``; at least 0.

    That is log(1 + x) / x = full / steps.
    """
    share = full / steps
    return 0.0 if share >= 1.0 else -float(lambertw(-share * math.exp(-share), -1).real) / share - 1.0


class Pace:
    """How fast a run goes since its first step, before which the start was made and colours were warmed up."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def left(self, progress: float, seconds: float) -> float | None:
        """Training seconds to the end, given those so far; None before the second step."""
        first, began = self._first = self._first or (progress, seconds)
        return None if progress <= first else (seconds - began) * (1 - progress) / (progress - first)
