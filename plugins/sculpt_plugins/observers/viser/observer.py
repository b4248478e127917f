"""The run's end of the viewer: leaves snapshots where the viewer's process finds them, and takes its commands.

The page is served by a process of its own, ``sculpt-view RUN_DIR``, which follows the run by its files. Whatever
happens there or in a browser, training is held up by nothing but taking a snapshot now and then.
"""

import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sculpt_framework.child_processes import OWN_GROUP
from sculpt_framework.commands import Command, TakeSnapshot, command_from_json
from sculpt_framework.errors import ConfigError, SculptError
from sculpt_framework.events import Event
from sculpt_framework.observers import SteeringObserver
from sculpt_framework.registry import name_of
from sculpt_framework.serialization import read_config
from sculpt_framework.snapshot import Snapshot
from sculpt_framework.viewing.frames import FOLDER, LIVE, step_path, write_frame
from sculpt_plugins.observers.viser.config import ViserConfig

_log = logging.getLogger("sculpt")
_FIRST_KEPT_SECONDS = 0.5
_KEPT_GROWTH = 1.15
"""Steps are kept at training times that grow by this factor: 10 s give 22 of them, 1000 s give 55."""
LAST_WORDS_SECONDS = 15.0
"""How long the viewer may take to show the end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Taken:
    snapshot: Snapshot
    outer: int
    t_train: float
    keep: bool


class ViserObserver(SteeringObserver):
    """Starts the viewer's process. Raises ConfigError if the page cannot be offered where it is asked for."""

    def __init__(self, config: ViserConfig, run_dir: Path):
        config.check_start()
        _require_recorder(run_dir)
        self._config = config
        self._run_dir = run_dir
        (run_dir / FOLDER).mkdir(exist_ok=True)
        self.address: str | None = None
        """Where the page is, once it is there."""
        self.watching = 0
        """Browsers that have the page open."""
        self._commands: deque[Command] = deque()
        self._outer, self._t_train = 0, 0.0
        self._next_kept = _FIRST_KEPT_SECONDS
        self._asked = False
        self._shown_outer = -1
        self._next_shown = float("-inf")
        self._ended = False
        # Guards the slot, which training overwrites and the publisher empties.
        self._slot = threading.Condition()
        self._taken: _Taken | None = None
        self._writing = False
        self._closing = False
        self._process = start_page(config, run_dir)
        self._threads = [
            threading.Thread(target=self._publish, name="viser-publish", daemon=True),
            threading.Thread(target=self._listen, name="viser-listen", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def snapshot_seconds(self) -> None:
        """Snapshots are asked for by command, and only while somebody looks or a step is to be kept."""
        return

    def take_commands(self) -> Sequence[Command]:
        out = [self._commands.popleft() for _ in range(len(self._commands))]
        if not self._asked and self._wants_snapshot():
            self._asked = True
            out.append(TakeSnapshot())
        return out

    def notify(self, event: Event) -> None:
        self._outer, self._t_train = event.outer, event.t_train
        if event.event == "run_ended":
            self._ended = True
        if event.event != "snapshot":
            return
        keep = event.t_train >= self._next_kept
        while self._next_kept <= event.t_train:
            self._next_kept *= _KEPT_GROWTH
        self._asked, self._shown_outer = False, event.outer
        self._next_shown = time.monotonic() + self._config.seconds
        taken = _Taken(snapshot=event.data["snapshot"], outer=event.outer, t_train=event.t_train, keep=keep)
        with self._slot:
            self._taken = taken
            self._slot.notify()

    def close(self) -> None:
        """What was told last is still shown; then the page goes away."""
        with self._slot:
            self._closing = True
            self._slot.notify()
        self._threads[0].join(timeout=LAST_WORDS_SECONDS)
        if self._ended:
            # mesh.ply and gaussians.ply are newer and hold as much.
            (self._run_dir / FOLDER / LIVE).unlink(missing_ok=True)
        _end(self._process)
        self._threads[1].join(timeout=1.0)

    def _wants_snapshot(self) -> bool:
        if self._outer == self._shown_outer:
            return False
        if self._t_train >= self._next_kept:
            return True
        # As long as the last one is not written, another would only be thrown away.
        busy = self._writing or self._taken is not None
        return self.watching > 0 and not busy and time.monotonic() >= self._next_shown

    def _publish(self) -> None:
        while True:
            with self._slot:
                self._writing = False
                self._slot.wait_for(lambda: self._taken is not None or self._closing)
                taken, self._taken = self._taken, None
                self._writing = taken is not None
            if taken is None:
                return
            try:
                self._write(taken)
            except SculptError as error:
                _log.warning("the viewer is not up to date: %s", error)

    def _write(self, taken: _Taken) -> None:
        outer, t_train = taken.outer, taken.t_train
        live = self._run_dir / FOLDER / LIVE
        write_frame(live, taken.snapshot, outer=outer, t_train=t_train, whole=True)
        if taken.keep:
            path = step_path(self._run_dir, outer)
            write_frame(path, taken.snapshot, outer=outer, t_train=t_train, whole=False)

    def _listen(self) -> None:
        """What the viewer's process says, a JSON object a line, until it ends."""
        assert self._process.stdout is not None, "it was started with a pipe"  # noqa: S101
        for line in self._process.stdout:
            try:
                said = json.loads(line)
                if "command" in said:
                    self._commands.append(command_from_json(said["command"]))
                elif "watching" in said:
                    self.watching = int(said["watching"])
                elif "listening" in said:
                    self.address = str(said["listening"])
                    _log.warning("viewer at %s", self.address)
                    if "SSH_CONNECTION" in os.environ:
                        _log.warning("from your own machine: ssh -L %d:127.0.0.1:%d HOST", *[self._config.port] * 2)
            except (ValueError, TypeError, SculptError) as error:
                _log.warning("the viewer said something unexpected: %s", error)
        self.watching = 0
        if not self._closing:
            _log.warning("the viewer has gone; training goes on. sculpt-view %s opens another", self._run_dir)


def _require_recorder(run_dir: Path) -> None:
    observers = [name_of(observer) for observer in read_config(run_dir / "config.json").observers]
    if "recorder" not in observers:
        names = " ".join((*observers, "recorder"))
        raise ConfigError(f"the viewer shows what the recorder writes; add it: --observers {names}")


def start_page(config: ViserConfig, run_dir: Path) -> "subprocess.Popen[str]":
    """The page's process: one thread a library, so that the cores stay with training."""
    words = [sys.executable, "-m", "sculpt_framework.cli.view", str(run_dir), "--steer"]
    words += ["--host", config.host, "--port", str(config.port)]
    single = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    return subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env={**os.environ, **single},
        # Ctrl-C is for training; this process ends when its input does.
        start_new_session=True,
        creationflags=OWN_GROUP,
    )


def _end(process: "subprocess.Popen[str]") -> None:
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(timeout=LAST_WORDS_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    finally:
        if process.stdout is not None:
            process.stdout.close()
