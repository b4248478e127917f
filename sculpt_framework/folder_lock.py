"""A folder that one process at a time works in."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from sculpt_framework.errors import ConfigError
from sculpt_framework.export.atomic import cannot_write


@contextmanager
def only_one(folder: Path, advice: str) -> Iterator[None]:
    """Hold the folder for this process; the system lets go of it however the process ends.

    Raises ConfigError if another process works in it, which ends with the ``advice`` on what to do but wait, and
    OutputError if it cannot be written.
    """
    lock = FileLock(folder / ".lock", mode=0o644)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise ConfigError(f"another process works in {folder}; wait for it, or {advice}.") from None
    except OSError as error:
        raise cannot_write(folder, error) from error
    try:
        yield
    finally:
        lock.release()
