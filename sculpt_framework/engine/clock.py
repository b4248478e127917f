"""Training seconds: what the optimisation alone takes, with everything else left out."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def process_start() -> float:
    """``time.monotonic()`` at the start of this process, so that wall time includes the imports."""
    if sys.platform != "linux":
        import psutil

        return time.monotonic() - max(0.0, time.time() - psutil.Process().create_time())
    try:
        with open("/proc/self/stat", encoding="ascii") as stat:
            ticks = float(stat.read().rsplit(")", 1)[1].split()[19])
        with open("/proc/uptime", encoding="ascii") as uptime:
            age = float(uptime.read().split()[0]) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.monotonic()  # A system that hides /proc: count from here.
    return time.monotonic() - max(0.0, age)


class TrainingClock:
    """Counts training seconds while running; ``pause`` leaves a stretch out. Wall seconds count from ``started``.

    ``idle`` tells the seconds so far of what happens in the midst of training and is none, such as compiling; what it
    grows by while the clock runs is left out too.
    """

    def __init__(self, started: float, trained: float = 0.0, idle: Callable[[], float] = lambda: 0.0):
        self._started = started
        self._trained = trained
        self._idle = idle
        self._since: float | None = None

    def start(self) -> None:
        if self._since is None:
            self._since = self.now

    def stop(self) -> None:
        if self._since is not None:
            self._trained += self.now - self._since
            self._since = None

    def go_on_from(self, trained: float) -> None:
        """Count from now on, after ``trained`` seconds of training in an earlier process; wall seconds stay."""
        self.stop()
        self._trained = trained
        self.start()

    @contextmanager
    def pause(self) -> Iterator[None]:
        running = self._since is not None
        self.stop()
        try:
            yield
        finally:
            if running:
                self.start()

    @property
    def train_seconds(self) -> float:
        return self._trained + (0.0 if self._since is None else self.now - self._since)

    @property
    def wall_seconds(self) -> float:
        return time.monotonic() - self._started

    @property
    def cpu_seconds(self) -> float:
        return time.process_time()

    @property
    def now(self) -> float:
        """Seconds from some instant; stands still while the process is idle."""
        return time.monotonic() - self._idle()

    def deadline(self, limit: float | None, *, share_left: float, seconds_left: float) -> float | None:
        """The ``time.monotonic()`` instant at which so much of ``limit`` wall seconds is left; None without a limit."""
        if limit is None:
            return None
        return time.monotonic() - self.wall_seconds + max(1.0, limit - seconds_left - share_left * limit)
