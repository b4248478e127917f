from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ObserverConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.observers.console.observer import ConsoleObserver


@dataclass(frozen=True, kw_only=True)
class ConsoleConfig(ObserverConfig):
    """Tells what happens: a live display where the output is a terminal, plain lines where it is not."""

    line_seconds: Annotated[float, at_least(0)] = 10.0
    """Wall seconds between lines of progress where the output is not a terminal."""
    live_seconds: Annotated[float, at_least(0)] = 0.25
    """Wall seconds between redraws of the live display."""

    def build(self, run_dir: Path) -> "ConsoleObserver":
        from rich.console import Console

        from sculpt_plugins.observers.console.observer import ConsoleObserver

        return ConsoleObserver(self, run_dir, Console(highlight=False, markup=False, soft_wrap=True))
