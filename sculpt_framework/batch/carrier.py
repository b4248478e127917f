"""What a scheduler calls on the machine it has chosen: start the run's process there and see it through."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from sculpt_framework.child_processes import INTERRUPT, die_with_parent
from sculpt_framework.experiments.launching import as_interrupt, start_process

GRACE_SECONDS = 25.0
"""How long an interrupted run may take to save: Slurm kills 30 s after it has asked."""

_LISTEN_SECONDS = 1.0
_ENDS = (signal.SIGTERM,) if sys.platform == "win32" else (signal.SIGTERM, signal.SIGUSR2)
"""What asks this process to end. By SIGUSR2 Slurm says that the time of a job is almost over."""


def carry(command: Sequence[str], log: str, environment: Mapping[str, str]) -> int:
    """Run the command until it ends and return its exit code.

    Being asked to end (SIGTERM, SIGUSR2, KeyboardInterrupt) is passed on to the run as Ctrl-C, so that it saves. If
    this process is killed, so is the run. Raises OutputError where the log cannot be written.
    """
    die_with_parent()
    with as_interrupt(_ENDS):
        with _heeding_interrupts():
            process = start_process(command, Path(log), {**os.environ, **environment})
        try:
            return _wait(process)
        except KeyboardInterrupt:
            process.send_signal(INTERRUPT)
            return _wait_or_kill(process)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()


def _wait(process: subprocess.Popen[bytes]) -> int:
    """Until it ends. Ray interrupts Python, not the system call that a wait without end would be."""
    while True:
        with suppress(subprocess.TimeoutExpired):
            return process.wait(_LISTEN_SECONDS)


def _wait_or_kill(process: subprocess.Popen[bytes]) -> int:
    try:
        return process.wait(GRACE_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


@contextmanager
def _heeding_interrupts() -> Iterator[None]:
    """Processes inherit which signals are blocked, and Ray's workers block SIGINT: a run would never hear of it. Of
    SIGUSR2, which Slurm may send to all processes of a job and which would end a run, it is not to hear. Windows has
    nothing of the kind."""
    if sys.platform == "win32":
        yield
        return
    blocked = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR2})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
