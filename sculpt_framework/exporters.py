"""Formats of ``sculpt-export``: what a run has made, as another program wants it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path


class Exporter(ABC):
    @abstractmethod
    def write(self, run_dir: Path, out: Path) -> Sequence[str]:
        """Write ``out``, a file or a folder; returns lines for the user: what was written, then what to know of it.

        A file is whole or not there (``export.atomic.write_atomically``). Raises SculptError; CheckpointError where the
        run directory does not have what is needed.
        """
