"""Files that are whole or not there: written aside, flushed to the disk, then renamed over the old one."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from sculpt_framework.errors import OutputError


def write_atomically(path: Path, content: bytes | Callable[[BinaryIO], None]) -> None:
    """Put ``content`` at ``path``; a callback gets the open file and writes into it.

    Whatever goes wrong, a file that was at ``path`` stays as it was and nothing is left beside it. Raises OutputError,
    naming ``path``, where the system refuses: disk full, no such folder, no permission.
    """
    if not path.name:
        raise OutputError(f"cannot write {path} (it is a folder); give the name of a file in it")
    aside = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        try:
            with open(aside, "wb") as file:
                if isinstance(content, bytes):
                    file.write(content)
                else:
                    content(file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(aside, path)
        finally:
            # After the rename there is nothing left to remove.
            aside.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from error


def make_folder(folder: Path) -> None:
    """The folder, and those above it, unless they are there. Raises OutputError where the system refuses."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error


def link_or_copy(source: Path, target: Path) -> Path:
    """``source`` under a second name as well, unless there is a file already: a link where the file system can, else a
    copy. Raises OSError where the system refuses."""
    if target.exists():
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:
        aside = target.with_name(f".{target.name}.{os.getpid()}.partial")
        shutil.copy2(source, aside)
        os.replace(aside, target)
    return target


def remove_partial_files(folder: Path) -> None:
    """Remove what writers that were killed have left in the folder and below it. No writer may be at work there.

    Raises OutputError where the system refuses.
    """
    for path in folder.rglob(".*.partial"):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_write(path, error) from error


def cannot_write(path: Path, error: OSError) -> OutputError:
    """The one line a user reads when the system refuses to write ``path``."""
    reason = error.strerror or str(error)
    return OutputError(f"cannot write {path} ({reason}); free space or choose another place for it")
