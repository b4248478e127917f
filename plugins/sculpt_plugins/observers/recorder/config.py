from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ObserverConfig
from sculpt_framework.ranges import at_least

if TYPE_CHECKING:
    from sculpt_plugins.observers.recorder.observer import RecorderObserver


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(ObserverConfig):
    """Keeps events, the error-against-time curve and the final measures in the run directory."""

    step_seconds: Annotated[float, at_least(0)] = 1.0
    """Wall seconds between recorded outer steps; 0 records every one. All other events are always recorded."""

    def build(self, run_dir: Path) -> "RecorderObserver":
        from sculpt_plugins.observers.recorder.observer import RecorderObserver

        return RecorderObserver(self, run_dir)
