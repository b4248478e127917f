"""Training processes with a viewer, as a user starts them, and what they tell in their files."""

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

STEPS = 100_000
"""More than any test waits for: a run ends when it is told to."""


def eventually(condition: Callable[[], bool], seconds: float = 180.0, found: Callable[[], object] = str) -> None:
    """Until the condition holds; fails in the end with what is ``found``."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, found()
        time.sleep(0.1)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def train_words(folder: Path, *more: str, port: int | None = None) -> list[str]:
    """The command that trains the smallest method on the demo, with a page at ``port`` if there is one."""
    words = ["gaussian-sculpting-tiny", "--data", "demo", "--output", str(folder), "--threads", "1"]
    words += ["--observers.recorder.step-seconds", "0", *more]
    if port is not None:
        words += ["--viewer", "--observers.viser.port", str(port), "--observers.viser.seconds", "0.5"]
    return [sys.executable, "-c", "from sculpt_framework.cli.train import main; main()", *words]


class Run:
    """A training process with a viewer on a port of its own."""

    def __init__(self, folder: Path, port: int, *more: str, steps: int = STEPS):
        self.folder = folder / "run"
        self.address = f"http://127.0.0.1:{port}"
        self.log = folder / "log.txt"
        words = train_words(self.folder, "--steps", str(steps), *more, port=port)
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(words, stdout=log, stderr=log)
        try:
            eventually(lambda: "viewer at" in self.log.read_text(encoding="utf-8") or self.process.poll() is not None)
            assert self.process.poll() is None, self.log.read_text(encoding="utf-8")
        except AssertionError:
            self.kill()
            raise

    @property
    def events(self) -> list[dict]:
        path = self.folder / "events.jsonl"
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]

    @property
    def outer_steps(self) -> list[dict]:
        return [event["data"] for event in self.events if event["event"] == "outer_step"]

    @property
    def steps(self) -> int:
        return max((event["outer"] for event in self.events if event["event"] == "outer_step"), default=0)

    @property
    def commands(self) -> list[dict]:
        """What the run was told and did not refuse."""
        told = [event["data"] for event in self.events if "command" in event["data"]]
        return [data["command"] for data in told if not data.get("refused")]

    def wait_for_command(self, **wanted: object) -> dict:
        """Until the run has obeyed a command with these entries; returns the latest."""

        def fitting() -> Sequence[dict]:
            return [command for command in self.commands if wanted.items() <= command.items()]

        eventually(lambda: bool(fitting()), found=lambda: f"{wanted} is not among {self.commands}")
        return fitting()[-1]

    def wait_for_steps(self, count: int) -> list[dict]:
        """The data of ``count`` steps that begin after now."""
        before = len(self.outer_steps)
        eventually(lambda: len(self.outer_steps) > before + count)
        return self.outer_steps[before + 1 :]

    def last_faces(self) -> int:
        return self.outer_steps[-1]["faces"]

    @property
    def cell(self) -> float:
        """Side of a grid cell, world units."""
        box = next(event["data"]["box"] for event in self.events if event["event"] == "run_started")
        grid = [event["data"]["grid"] for event in self.events if event["event"] == "stage"][-1]
        return max((high - low) / count for low, high, count in zip(*box, grid, strict=True))

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()
