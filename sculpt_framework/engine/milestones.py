"""When a run measures itself, and what it found."""

from collections.abc import Sequence
from typing import Any

_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the run at which a measurement is owed, whatever it costs."""
_COST_AT_MOST = 0.08
"""Of training time, for the measurements in between."""


class Milestones:
    """Rows of the error-against-time curve: at geometric times (1, 2, 4, ... s) and at fixed shares of the run."""

    def __init__(self, rows: Sequence[dict[str, Any]] = ()):
        self.rows: list[dict[str, Any]] = list(rows)
        self._next_second = 1.0

    def due(self, progress: float, trained: float, spent: float) -> bool:
        """``trained`` and ``spent`` are seconds of training and of evaluation so far."""
        done = self.rows[-1]["progress"] if self.rows else 0.0
        if any(done < share <= progress for share in _SHARES[:-1]):
            return True
        if trained < self._next_second:
            return False
        while self._next_second <= trained:
            self._next_second *= 2
        return spent <= _COST_AT_MOST * trained

    def add(self, progress: float, row: dict[str, Any]) -> None:
        self.rows.append({**row, "progress": progress})

    def latest(self, column: str) -> Any:
        return self.rows[-1][column] if self.rows else None

    def shares(self) -> list[dict[str, Any]]:
        """The first row at or after each of 25, 50 and 100 % of the run."""
        out = []
        for share in (0.25, 0.5, 1.0):
            row = next((row for row in self.rows if row["progress"] >= share - 1e-9), None)
            if row is not None:
                out.append({"share": share, "chamfer_ps": row["chamfer_ps"], "psnr": row["psnr"], "iou": row["iou"]})
        return out
