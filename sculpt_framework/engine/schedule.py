"""How far a run is: progress from 0 to 1, by steps or by the clock."""

import time

_LEFT = 0.2
"""Of a run that is cut short: its rates fall to the end within it."""


class Schedule:
    """Progress by steps, or, if a deadline is given, by the clock.

    With a deadline the number of steps follows from the machine's speed, so runs are not repeatable bit by bit; without
    one they are.
    """

    def __init__(self, steps: int, deadline: float | None):
        """``deadline`` is a ``time.monotonic()`` instant at which optimisation has to end."""
        self._steps = steps
        self._deadline = deadline
        self._began: float | None = None
        self._done_before = 0.0

    @property
    def timed(self) -> bool:
        return self._deadline is not None

    @property
    def total_steps(self) -> int | None:
        return None if self.timed else self._steps

    def begin(self, done: float = 0.0) -> None:
        """Optimisation starts now; a share ``done`` of it has been done before, in the resumed run.

        The start must be made by then: rates that fall while nothing is optimised are too low for what comes after.
        """
        self._began = time.monotonic()
        self._done_before = done

    def progress(self, step: int) -> float:
        """Share of the run that is done after ``step`` steps, at most 1."""
        if self._deadline is None:
            return min(1.0, step / max(1, self._steps))
        if self._began is None:
            return self._done_before
        span = self._deadline - self._began
        return 1.0 if span <= 0 else min(1.0, self._done_before + (time.monotonic() - self._began) / span)

    def end_by(self, deadline: float | None) -> None:
        """Optimisation has to end by this instant, if that is sooner: what follows takes longer than was known."""
        if self._deadline is not None and deadline is not None:
            self._deadline = min(self._deadline, deadline)

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


class Pace:
    """How fast a run goes since its first step, before which the start was made and colours were warmed up."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def left(self, progress: float, seconds: float) -> float | None:
        """Training seconds to the end, given those so far; None before the second step."""
        first, began = self._first = self._first or (progress, seconds)
        return None if progress <= first else (seconds - began) * (1 - progress) / (progress - first)
