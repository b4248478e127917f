"""The console: a live display in a terminal, plain lines elsewhere, the same words in both."""

from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from sculpt_framework.events import Event
from sculpt_framework.observers import Observer
from sculpt_framework.plan.table import plan_table
from sculpt_plugins.observers.console.config import ConsoleConfig
from sculpt_plugins.observers.console.wording import (
    duration,
    end_lines,
    error_text,
    message_text,
    stage_text,
    start_lines,
    step_facts,
    step_line,
)

_MESSAGES = {
    "decision": "decided: ",
    "action": "",
    "warning": "warning: ",
    "recovered": "recovered: ",
}
"""Events that are told in one line, with what the line begins with."""


_TABLE_WIDTH = 160
"""Characters of a table's line where the output is no terminal."""


class ConsoleObserver(Observer):
    """Writes to ``console``; ``run_dir`` is named at the end."""

    def __init__(self, config: ConsoleConfig, run_dir: Path, console: Console):
        self._config = config
        self._run_dir = run_dir
        self._console = console
        # The display draws when told to: a thread of its own would take time from training.
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._next_step = float("-inf")
        self._stage = ""
        self._error = ""

    @property
    def snapshot_seconds(self) -> None:
        return None

    def notify(self, event: Event) -> None:
        data = event.data
        match event.event:
            case "plan":
                self._say_table(plan_table(data))
            case "run_started":
                self._say(*start_lines(data))
                if self._live is not None:
                    self._live.start()
            case "stage":
                self._stage = stage_text(data)
                self._say(self._stage)
            case "outer_step":
                self._step(event)
            case "evaluation":
                self._error = error_text(data)
                if self._error:
                    self._say(f"after {duration(event.t_train)} of training: {self._error}")
            case "decision" | "action" | "warning" | "recovered":
                self._say(_MESSAGES[event.event] + message_text(data))
            case "run_ended":
                self.close()
                self._say(*end_lines(data, self._run_dir))

    def close(self) -> None:
        if self._live is not None:
            self._live.stop()

    def _say(self, *lines: str) -> None:
        for line in lines:
            self._console.print(line)

    def _say_table(self, table: Table) -> None:
        width = self._console.width
        if not self._console.is_terminal:
            # Nobody's window: lines in a file need no breaking.
            self._console.width = _TABLE_WIDTH
        self._console.print(table)
        self._console.width = width

    def _step(self, event: Event) -> None:
        if event.t_wall < self._next_step:
            return
        if self._live is None:
            self._next_step = event.t_wall + self._config.line_seconds
            self._say(step_line(event.data, event.outer))
        else:
            self._next_step = event.t_wall + self._config.live_seconds
            self._live.update(self._display(event), refresh=True)

    def _display(self, event: Event) -> Group:
        """Two lines: how far, how long, and what the latest step was like."""
        progress = event.data["progress"]
        eta = event.data.get("eta_s")
        bar = Table.grid(padding=(0, 1))
        bar.add_row(
            ProgressBar(total=1.0, completed=progress, width=40),
            f"{100 * progress:3.0f} %",
            f"step {event.outer}",
            f"{duration(event.t_wall)} gone" + (f", {duration(eta)} left" if eta is not None else ""),
        )
        facts = Text(no_wrap=True, overflow="ellipsis")
        for label, value in step_facts(event.data):
            facts.append(f"{label} ", style="dim").append(f"{value}   ")
        status = Text(
            " · ".join(filter(None, [self._stage, self._error])), style="dim", no_wrap=True, overflow="ellipsis"
        )
        return Group(bar, facts, status)
