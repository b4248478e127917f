"""What became of each run of an experiment, kept on disk after every change."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from sculpt_framework.errors import ConfigError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.json_text import json_text

LEDGER_NAME = "state.json"
LEDGER_SCHEMA = 1
Status = Literal["pending", "running", "finished", "failed", "interrupted"]


@dataclass(frozen=True, kw_only=True)
class CellState:
    """How far a run is."""

    status: Status = "pending"
    attempts: int = 0
    seconds: float | None = None
    """Wall seconds of the latest attempt, as seen from outside."""
    exit_code: int | None = None
    error: str | None = None
    """The last line the run said about its failure."""


class Ledger:
    """The states of the cells of an experiment; ``set`` writes the whole file aside and renames it."""

    def __init__(self, folder: Path):
        """Raises ConfigError where there is a file of that name that is something else."""
        self._path = folder / LEDGER_NAME
        self._states: dict[str, CellState] = {}
        if not self._path.exists():
            return
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
            self._states = {name: CellState(**state) for name, state in document["cells"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ConfigError(f"{self._path} cannot be read ({error}); give another --out.") from error

    def get(self, name: str) -> CellState:
        return self._states.get(name, CellState())

    def set(self, name: str, state: CellState) -> None:
        """Raises OutputError where the file cannot be written."""
        self._states[name] = state
        document: dict[str, Any] = {"schema": LEDGER_SCHEMA, "cells": {n: asdict(s) for n, s in self._states.items()}}
        write_atomically(self._path, (json_text(document, indent=1) + "\n").encode())
