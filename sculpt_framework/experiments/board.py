"""What people see while a matrix is run: a bar with the time that is left in a terminal, a line per run elsewhere."""

import statistics
from collections.abc import Callable, Mapping, Sequence

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from sculpt_framework.experiments.ledger import CellState
from sculpt_framework.experiments.matrix import Cell
from sculpt_framework.experiments.runner import Board


class ConsoleBoard(Board):
    """Tells of a matrix's runs on ``console``; ``describe`` gives the result of one that finished in a few words."""

    def __init__(self, console: Console, describe: Callable[[Cell], str], jobs: int):
        self._console = console
        self._describe = describe
        self._jobs = jobs
        self._remaining: list[Cell] = []
        self._running: list[Cell] = []
        self._seconds: dict[str, list[float]] = {}
        self._total = 0
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
            transient=True,
        )
        self._task = self._progress.add_task("", total=None, left="")

    def begin(self, waiting: Sequence[Cell], settled: Mapping[str, CellState]) -> None:
        self._remaining = list(waiting)
        self._total = len(waiting) + len(settled)
        failed = sum(state.status == "failed" for state in settled.values())
        if settled:
            note = f", {failed} of them failed (--retry-failed runs those again)" if failed else ""
            self._say(f"{len(settled)} of {self._total} runs were done before{note}.")
        if self._console.is_terminal and waiting:
            self._progress.start()
        self._show()

    def close(self) -> None:
        self._progress.stop()

    def warming_up(self, scene: str) -> None:
        self._say(f"warming up on {scene}: rendering and compiling are done before anything is timed")

    def warned(self, message: str) -> None:
        self._say(f"warning: {message}")

    def started(self, cell: Cell, resumed: bool) -> None:
        if cell not in self._running:  # it is where a run is tried again
            self._running.append(cell)
        if resumed:
            self._say(f"{cell.name} goes on from its checkpoint")
        self._show()

    def ended(self, cell: Cell, state: CellState) -> None:
        self._running.remove(cell)
        self._remaining.remove(cell)
        if state.seconds is not None and state.status == "finished":
            self._seconds.setdefault(_kind(cell), []).append(state.seconds)
        done = self._total - len(self._remaining)
        what = self._describe(cell) if state.status == "finished" else f"{state.status}: {state.error}"
        seconds = "" if state.seconds is None else f" ({_duration(state.seconds)})"
        left = self.left()
        self._say(f"[{done}/{self._total}] {cell.name}: {what}{seconds}{'; ' + left if left else ''}")
        self._show()

    def left(self) -> str:
        """How long the rest will take, from runs like it that have ended; "" if that is not known yet."""
        if not self._remaining:
            return ""
        expected = [self._expected(cell) for cell in self._remaining]
        known = [seconds for seconds in expected if seconds is not None]
        if not known:
            return ""
        # Runs of a kind not seen yet are taken to be like the others.
        total = sum(known) * len(expected) / len(known)
        return f"about {_duration(total / self._jobs)} left"

    def _expected(self, cell: Cell) -> float | None:
        seen = self._seconds.get(_kind(cell))
        if seen:
            return statistics.median(seen)
        return cell.budget.amount if cell.timed and cell.budget else None

    def _show(self) -> None:
        names = ", ".join(cell.name for cell in self._running)
        done = self._total - len(self._remaining)
        self._progress.update(self._task, description=names, completed=done, total=self._total, left=self.left())

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def _kind(cell: Cell) -> str:
    """Runs that take about the same time."""
    return cell.budget.label if cell.budget else "no budget"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
