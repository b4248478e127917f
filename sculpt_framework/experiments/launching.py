"""Where the process of a run is started: on this machine here; sculpt_framework.batch has schedulers of clusters."""

import os
import signal
import subprocess
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import IO

from sculpt_framework.child_processes import INTERRUPT, OWN_GROUP, ending_with_parent
from sculpt_framework.cores import usable_cores
from sculpt_framework.errors import DeviceError, OutputError

KILLED = -9
"""Exit code of a process that somebody killed (SIGKILL), or that went down with its machine."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """A process that is to be started."""

    name: str
    """What people call the run."""
    command: tuple[str, ...]
    log: Path
    """Where it writes to; replaced."""
    environment: Mapping[str, str] = field(default_factory=dict)
    """Variables beside those that the process finds where it is started."""


class Job(ABC):
    """A process at work, here or elsewhere."""

    @abstractmethod
    def poll(self) -> int | None:
        """Its exit code, minus the number of the signal that ended it; None while it is at work. Returns at once."""

    @abstractmethod
    def interrupt(self) -> None:
        """Ask it to save and end, as Ctrl-C does. Nothing happens where it has ended."""

    @abstractmethod
    def kill(self) -> None:
        """End it now. Nothing happens where it has ended."""


class Engine(ABC):
    """Starts processes that share a file system with this one. However it ends, none of them goes on after it."""

    @abstractmethod
    def start(self, order: Order) -> Job:
        """Raises OutputError where the log cannot be written, JobRefusedError where a scheduler takes no more now."""

    @abstractmethod
    def close(self) -> None:
        """Give back what was taken; no job is at work any more."""


class LocalEngine(Engine):
    """Processes of this machine. At most ``jobs`` are started at a time; the caller sees to it."""

    def __init__(self, jobs: int = 1, *, gpus_per_run: int = 0, cpus_per_run: int | None = None):
        """Several jobs share the cores between them unless the user has decided otherwise, by OMP_NUM_THREADS or here.

        Each has ``gpus_per_run`` CUDA devices of its own; 0: all see all. Raises DeviceError if there are too few.
        """
        self._environment = dict(os.environ)
        if cpus_per_run is not None:
            self._environment["OMP_NUM_THREADS"] = str(cpus_per_run)
        elif jobs > 1:
            self._environment.setdefault("OMP_NUM_THREADS", str(max(1, usable_cores() // jobs)))
        self._gpus_per_run = gpus_per_run
        self._free: list[str] = visible_devices() if gpus_per_run else []
        if len(self._free) < jobs * gpus_per_run:
            raise DeviceError(
                f"{jobs} runs at a time with {gpus_per_run} CUDA devices each need {jobs * gpus_per_run}; there are "
                f"{len(self._free)} here. Lower --workers or --gpus-per-run."
            )

    def start(self, order: Order) -> Job:
        taken = [self._free.pop(0) for _ in range(self._gpus_per_run)]
        environment = {**self._environment, **order.environment}
        if taken:
            environment["CUDA_VISIBLE_DEVICES"] = ",".join(taken)
        return _LocalJob(start_process(order.command, order.log, environment), taken, self._free)

    def close(self) -> None:
        pass


class _LocalJob(Job):
    def __init__(self, process: subprocess.Popen[bytes], taken: Sequence[str], free: list[str]):
        self._process = process
        self._taken = taken
        self._free = free

    def poll(self) -> int | None:
        code = self._process.poll()
        if code is not None:
            self._free.extend(self._taken)
            self._taken = ()
        return code

    def interrupt(self) -> None:
        self._process.send_signal(INTERRUPT)

    def kill(self) -> None:
        self._process.kill()


def start_process(command: Sequence[str], log: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """A process that writes into ``log`` and, on Linux, is killed when this one dies.

    It has a group of its own: a terminal's Ctrl-C reaches only us, and we decide. Raises OutputError.
    """
    try:
        with open_log(log) as output:
            return subprocess.Popen(
                # Two processes in one run directory would leave neither's run: no run outlives who watches it.
                ending_with_parent(command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=dict(environment),
                process_group=0,
                creationflags=OWN_GROUP,
            )
    except OSError as error:
        raise OutputError(f"cannot start a run with its log at {log}: {error.strerror}.") from error


@contextmanager
def as_interrupt(numbers: Sequence[signal.Signals]) -> Iterator[None]:
    """These signals end what is inside as Ctrl-C does: runs are stopped, and save."""

    def handle(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield  # Signals are for whoever runs us to decide about.
        return
    previous = [(number, signal.signal(number, handle)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in previous:
            signal.signal(number, handler)


def open_log(path: Path) -> IO[bytes]:
    path.parent.mkdir(parents=True, exist_ok=True)
    return open(path, "wb")


def visible_devices() -> list[str]:
    """CUDA devices of this machine that this process may use, as CUDA_VISIBLE_DEVICES names them."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES")
    if given is not None:
        return [name.strip() for name in given.split(",") if name.strip()]
    import torch

    return [str(index) for index in range(torch.cuda.device_count())]
