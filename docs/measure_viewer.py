"""What watching costs: processor time of the training process per outer step, with and without somebody looking.

    python docs/measure_viewer.py [--method M] [--data DIR] [--steps N] [--rounds N]

One run with a viewer. Its outer steps come in blocks, in rounds of three: nobody looks, a client of the page's protocol
takes all it is sent, a client has connected and takes nothing; every other round goes the other way round. The client
is a process of its own, and so is the page, which runs at low priority: neither is counted.

Counted is the processor time of the training process, all its threads, from the end of the step before to the end of
the step; measuring the mesh and saving are left out. Of each round the blocks are compared with the one where nobody
looked; told are the median of the rounds' ratios and the middle half of them. Views differ in what they cost, so with
few steps the ratios scatter: the last column does not. It is what the viewer itself took of the same time: its threads,
and the training thread while it takes snapshots and commands.
"""

import argparse
import contextlib
import multiprocessing
import socket
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from sculpt_framework.cli.train import limit_threads
from sculpt_framework.command_line.request import parse

LOOKS = ("nobody", "a client", "a stalled client")


@dataclass(frozen=True, kw_only=True)
class Block:
    """CPU seconds of a block of steps, and what of them went to the viewer's own threads and to steering."""

    total: float
    viewer: float


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--method", default="gaussian-sculpting")
    options.add_argument("--data", default="demo")
    options.add_argument("--steps", type=int, default=20, help="outer steps in a block")
    options.add_argument("--rounds", type=int, default=7, help="blocks of each kind")
    options.add_argument("--warm-up", type=int, default=40, help="outer steps before the first block")
    chosen = options.parse_args()
    limit_threads(None)
    with tempfile.TemporaryDirectory() as folder:
        blocks = measure(chosen, Path(folder))
    sys.stdout.write(table(blocks, chosen.steps))


def table(blocks: dict[str, list[Block]], steps: int) -> str:
    """Markdown; one row for each who looked."""
    lines = ["| who looks | CPU s per step | against nobody | middle half | of which the viewer's own |"]
    lines.append("|---|---|---|---|---|")
    for look in LOOKS:
        own = sum(block.viewer for block in blocks[look]) / sum(block.total for block in blocks[look])
        seconds = statistics.median(block.total for block in blocks[look]) / steps
        ratios = [b.total / base.total for b, base in zip(blocks[look], blocks[LOOKS[0]], strict=True)]
        low, _, high = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else [ratios[0]] * 3
        median = statistics.median(ratios)
        lines.append(f"| {look} | {seconds:.4f} | {median:.3f} | {low:.3f} to {high:.3f} | {100 * own:.2f} % |")
    return "\n".join(lines) + "\n"


def measure(chosen: argparse.Namespace, folder: Path) -> dict[str, list[Block]]:
    """The blocks, by who looked, round by round."""
    from sculpt_framework.engine.session import Session
    from sculpt_framework.engine.steering import Steering
    from sculpt_framework.serialization import config_to_json
    from sculpt_plugins.observers.recorder.config import RecorderConfig
    from sculpt_plugins.observers.viser.config import ViserConfig

    words = [chosen.method, "--data", chosen.data, "--observers", "recorder", "viser"]
    order = [look for index in range(chosen.rounds) for look in (LOOKS, LOOKS[::-1])[index % 2]]
    total = chosen.warm_up + chosen.steps * len(order)
    # Blocks are of one stage: the first one's share is all of the run.
    config = parse([*words, "--steps", str(100 * total)])
    (folder / "config.json").write_text(config_to_json(config), encoding="utf-8")
    port = _free_port()
    observers = [RecorderConfig().build(folder), ViserConfig(port=port).build(folder)]
    viewer = observers[1]
    looking = Looking(f"http://127.0.0.1:{port}", lambda: viewer.watching)
    out: dict[str, list[Block]] = {look: [] for look in LOOKS}
    meter = Meter()

    def before_step() -> bool:
        done = session.step - chosen.warm_up
        if done >= 0 and done % chosen.steps == 0:
            index = done // chosen.steps
            if index > 0:
                out[order[index - 1]].append(meter.block())
            if index == len(order):
                return True
            looking.change(order[index])
            meter.block()
        return meter.steering(steering)

    def emit(event: Any) -> None:
        if event.event == "outer_step":
            meter.step_ended()
        for observer in observers:
            observer.notify(event)

    session = Session(config.dataset.build(config.data).load(), config, emit=emit)
    steering = Steering(session, folder=folder, sources=[viewer.take_commands])
    try:
        for _ in session:
            if before_step():
                break
    finally:
        looking.close()
        for observer in observers:
            observer.close()
    return out


class Meter:
    """Sums what steps take, from asking the viewer to their end."""

    def __init__(self) -> None:
        self._began = self._threads_began = self._total = self._viewer = 0.0

    def steering(self, steering: Callable[[], bool]) -> bool:
        """The first part of a step."""
        self._began, self._threads_began = time.process_time(), _viewer_threads_seconds()
        began = time.thread_time()
        ends = steering()
        self._viewer += time.thread_time() - began
        return ends

    def step_ended(self) -> None:
        self._total += time.process_time() - self._began
        self._viewer += _viewer_threads_seconds() - self._threads_began

    def block(self) -> Block:
        """What was summed since the last one."""
        block = Block(total=self._total, viewer=self._viewer)
        self._total = self._viewer = 0.0
        return block


def _viewer_threads_seconds() -> float:
    """CPU seconds of the viewer's threads in this process so far."""
    threads = [each for each in threading.enumerate() if each.name.startswith("viser-") and each.ident is not None]
    return sum(time.clock_gettime(time.pthread_getcpuclockid(each.ident or 0)) for each in threads)


class Looking:
    """The client's process: opens and closes the page at ``address``; ``watching`` is what the viewer believes."""

    def __init__(self, address: str, watching: Callable[[], int]):
        self._watching = watching
        context = multiprocessing.get_context("spawn")
        self._told, end = context.Pipe()
        self._process = context.Process(target=_client, args=(address, end), daemon=True)
        self._process.start()

    def change(self, look: str) -> None:
        """From now on ``look`` is who looks; returns when the viewer has noticed."""
        self._told.send(look)
        _until(lambda: self._watching() == (0 if look == LOOKS[0] else 1))

    def close(self) -> None:
        self._process.terminate()
        self._process.join()


def _client(address: str, told: Connection) -> None:
    """In its own process: looks as it is told to."""
    from sculpt_framework.testing.viewer_client import announce, connected

    client, look = None, LOOKS[0]
    while True:
        if told.poll(0.0 if look == LOOKS[1] else None):
            look = told.recv()
            if client is not None:
                client.close()
                client = None
            if look != LOOKS[0]:
                client = _open(lambda: connected(address))
                announce(client)
        elif client is not None:
            with contextlib.suppress(TimeoutError):
                client.recv(timeout=0.2)


def _open(connect: Callable[[], Any]) -> Any:
    """The page is there some seconds after the run has begun."""
    deadline = time.monotonic() + 120
    while True:
        try:
            return connect()
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError("the viewer does not answer")
        time.sleep(0.05)


if __name__ == "__main__":
    main()
