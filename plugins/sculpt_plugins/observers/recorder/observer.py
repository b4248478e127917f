"""The recorder: files that grow while the run goes on, each line whole, and one summary at its end."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sculpt_framework.evaluation.curve import CURVE_COLUMNS, header_line, parse_curve, row_line
from sculpt_framework.evaluation.versions import installed_versions
from sculpt_framework.events import Event
from sculpt_framework.export.atomic import cannot_write, write_atomically
from sculpt_framework.export.json_text import json_text
from sculpt_framework.observers import Observer
from sculpt_plugins.observers.recorder.config import RecorderConfig

EVENTS_VERSION = 1
METRICS_SCHEMA = 1
_NOT_MEASURES = ("reason", "progress", "t_train_s", "t_wall_s")
"""What evaluations say about themselves, beside the columns; the run's end is later than its last one."""


class RecorderObserver(Observer):
    """Writes RUN_DIR/events.jsonl, curve.csv and metrics.json.

    Raises OutputError, naming the file, where one cannot be written.
    """

    def __init__(self, config: RecorderConfig, run_dir: Path):
        self._config = config
        self._events_path = run_dir / "events.jsonl"
        self._curve_path = run_dir / "curve.csv"
        self._metrics_path = run_dir / "metrics.json"
        self._started: Mapping[str, Any] = {}
        self._next_step = float("-inf")
        self._curve_begun = False

    @property
    def snapshot_seconds(self) -> None:
        return None

    def notify(self, event: Event) -> None:
        if event.event == "snapshot":
            return
        if event.event == "outer_step":
            if event.t_wall < self._next_step:
                return
            self._next_step = event.t_wall + self._config.step_seconds
        if event.event == "run_started":
            self._started = event.data
            self._end_cut_line()
        elif not self._curve_begun:
            self._begin_curve(event.t_train)
        append(self._events_path, event_line(event))
        if event.event == "evaluation":
            append(self._curve_path, row_line(curve_row(event)))
        if event.event == "run_ended":
            metrics = json_text(metrics_of({**self._started, **event.data}, event), indent=2) + "\n"
            write_atomically(self._metrics_path, metrics.encode("utf-8"))

    def close(self) -> None:
        """Nothing is held open: every line is written through at once."""

    def _end_cut_line(self) -> None:
        """A run that was killed may have left half a line; the next event must not be glued to it."""
        if self._events_path.exists() and not self._events_path.read_bytes().endswith(b"\n"):
            append(self._events_path, "\n")

    def _begin_curve(self, t_train: float) -> None:
        """Begin the curve, or go on with that of an interrupted run.

        What that run did after its checkpoint is about to be done again: the curve is cut back to ``t_train``, so that
        its clock keeps going forwards.
        """
        rows = []
        if self._curve_path.exists():
            text = self._curve_path.read_text(encoding="ascii")
            rows = [row for row in parse_curve(text, self._curve_path) if (row["t_train_s"] or 0.0) <= t_train]
        write_atomically(self._curve_path, (header_line() + "".join(map(row_line, rows))).encode("ascii"))
        self._curve_begun = True


def append(path: Path, line: str) -> None:
    """Add a line to a file, past all buffers. Raises OutputError, naming the file, where the system refuses."""
    try:
        with open(path, "ab", buffering=0) as file:
            rest = line.encode("utf-8")
            while rest:
                rest = rest[file.write(rest) :]
    except OSError as error:
        raise cannot_write(path, error) from error


def event_line(event: Event) -> str:
    """An event as a line of events.jsonl."""
    record = {
        "v": EVENTS_VERSION,
        "t_train": round(event.t_train, 4),
        "t_wall": round(event.t_wall, 4),
        "outer": event.outer,
        "event": event.event,
        "data": event.data,
    }
    return json_text(record) + "\n"


def curve_row(event: Event) -> Mapping[str, Any]:
    """The columns of curve.csv from an evaluation; what the event knows itself need not be in its data."""
    return {"t_train_s": event.t_train, "t_wall_s": event.t_wall, "outer": event.outer, **event.data}


def metrics_of(facts: Mapping[str, Any], event: Event) -> Mapping[str, Any]:
    """The content of metrics.json. ``facts`` is what the start and the end of the run said about it."""
    final = {**dict.fromkeys(CURVE_COLUMNS), "t_train_s": event.t_train, "t_wall_s": event.t_wall, "outer": event.outer}
    final |= {name: value for name, value in (facts.get("final") or {}).items() if name not in _NOT_MEASURES}
    return {
        "schema": METRICS_SCHEMA,
        "status": facts.get("status"),
        "method": facts.get("method"),
        "scene": facts.get("scene"),
        "seed": facts.get("seed"),
        "device": facts.get("device"),
        "final": final,
        "milestones": facts.get("milestones"),
        "certificate": facts.get("certificate"),
        "versions": facts.get("versions") or installed_versions(),
    }
