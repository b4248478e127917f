"""Posing in a terminal: a bar for each step, with the time left; plain lines elsewhere."""

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from sculpt_framework.posing.announcer import Announcer

_LINE_SECONDS = 10.0
"""Between lines of a step where the output is not a terminal."""


class ConsoleAnnouncer(Announcer):
    """Writes to stderr, between ``with`` and its end."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
        columns = (TextColumn("{task.description:<22}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._bars = Progress(*columns, console=self._console, disable=not self._console.is_terminal)
        self._step, self._task, self._done = "", TaskID(0), 0
        self._began = self._next_line = 0.0

    def __enter__(self) -> "ConsoleAnnouncer":
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def say(self, line: str) -> None:
        self._console.print(line)

    def step(self, name: str, done: int, total: int) -> None:
        now = time.monotonic()
        if name != self._step:
            self._step, self._began, self._next_line, self._done = name, now, now, -1
            self._task = self._bars.add_task(name, total=total)
        self._bars.update(self._task, completed=done, total=total)
        due = done != self._done and (now >= self._next_line or done == total)
        if due and not self._console.is_terminal:
            self._next_line, self._done = now + _LINE_SECONDS, done
            left = (now - self._began) / done * (total - done) if 0 < done < total else None
            self.say(f"{name}: {done} of {total}" + ("" if left is None else f", {left:.0f} s left"))
