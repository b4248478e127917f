"""Processes that are killed when the one that started them dies, on Linux; elsewhere they live on."""

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence

INTERRUPT = signal.CTRL_BREAK_EVENT if sys.platform == "win32" else signal.SIGINT
"""What asks a process of a group of its own to save and end, as Ctrl-C does."""
OWN_GROUP = subprocess.CREATE_NEW_PROCESS_GROUP if sys.platform == "win32" else 0
"""Flags of ``subprocess.Popen``, beside ``process_group=0``, for a process that a terminal's Ctrl-C does not reach."""
_PR_SET_PDEATHSIG = 1
_PROGRAM = """
import ctypes, os, signal, sys
PR_SET_PDEATHSIG = 1
ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
if os.getppid() != int(sys.argv[1]):
    os.kill(os.getpid(), signal.SIGKILL)
os.execvp(sys.argv[2], sys.argv[2:])
"""


def ending_with_parent(command: Sequence[str]) -> tuple[str, ...]:
    """The command as one that this thread's death ends, to be started from it."""
    if sys.platform != "linux":
        return tuple(command)
    return (sys.executable, "-S", "-c", _PROGRAM, str(os.getpid()), *command)


def die_with_parent() -> None:
    """Have this process killed when the one that started it dies."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
