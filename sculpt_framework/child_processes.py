"""Processes that are killed when the one that started them dies, on Linux; elsewhere they live on."""

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

_PR_SET_PDEATHSIG = 1
_PROGRAM = """
import ctypes, os, signal, sys
PR_SET_PDEATHSIG = 1
ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
if os.getppid() != int(sys.argv[1]):
    os.kill(os.getpid(), signal.SIGKILL)
os.execvp(sys.argv[2], sys.argv[2:])
"""


def leashed(command: Sequence[str]) -> tuple[str, ...]:
    """The command as one that this thread's death ends, to be started from it."""
    if sys.platform != "linux":
        return tuple(command)
    return (sys.executable, "-S", "-c", _PROGRAM, str(os.getpid()), *command)


def die_with_parent() -> None:
    """Have this process killed when the one that started it dies."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
