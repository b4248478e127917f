"""What watching costs: processor time of the training process per outer step, with and without somebody looking.

    python docs/measure_viewer.py [--method M] [--data DIR] [--steps N] [--rounds N]

One run with a viewer. Its outer steps come in blocks, in turn: nobody looks, a client of the page's protocol takes all
it is sent, a client has connected and takes nothing. The processor time of the training process (all its threads, the
snapshots and their writing included) is taken over each block; compared are the sums over the rounds. The page's own
process is not counted: it runs at low priority, and on cores of its own where there are any.
"""

import argparse
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sculpt_framework.cli.train import parse

LOOKS = ("nobody", "a client", "a stalled client")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--method", default="gaussian-sculpting")
    options.add_argument("--data", default="demo")
    options.add_argument("--steps", type=int, default=10, help="outer steps in a block")
    options.add_argument("--rounds", type=int, default=6, help="blocks of each kind")
    options.add_argument("--warm-up", type=int, default=40, help="outer steps before the first block")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seconds = measure(chosen, Path(folder))
    base = sum(seconds[LOOKS[0]])
    sys.stdout.write("| who looks | CPU s per step | against nobody |\n|---|---|---|\n")
    for look in LOOKS:
        total, blocks = sum(seconds[look]), len(seconds[look])
        sys.stdout.write(f"| {look} | {total / (blocks * chosen.steps):.4f} | {total / base:.3f} |\n")


def measure(chosen: argparse.Namespace, folder: Path) -> dict[str, list[float]]:
    """Processor seconds of the blocks, by who looked."""
    from sculpt_framework.engine.pipeline import Pipeline
    from sculpt_framework.engine.steering import Steering
    from sculpt_framework.serialization import config_to_json
    from sculpt_plugins.observers.recorder.config import RecorderConfig
    from sculpt_plugins.observers.viser.config import ViserConfig

    words = [chosen.method, "--data", chosen.data, "--observers", "recorder", "viser"]
    total = chosen.warm_up + chosen.steps * chosen.rounds * len(LOOKS)
    # Blocks are of one stage: the first one's share is all of the run.
    config = parse([*words, "--trainer.outer-steps", str(100 * total)])
    (folder / "config.json").write_text(config_to_json(config))
    port = _free_port()
    observers = [RecorderConfig().build(folder), ViserConfig(port=port).build(folder)]
    viewer = observers[1]
    looking = Looking(port)
    out: dict[str, list[float]] = {look: [] for look in LOOKS}
    mark: list[float] = []

    def before_step() -> bool:
        done = pipeline.outer - chosen.warm_up
        if done >= 0 and done % chosen.steps == 0:
            now = time.process_time()
            if mark:
                look = LOOKS[(done // chosen.steps - 1) % len(LOOKS)]
                out[look].append(now - mark.pop())
            if pipeline.outer >= total:
                return True
            looking.change(LOOKS[done // chosen.steps % len(LOOKS)], viewer)
            mark.append(time.process_time())
        return steering()

    def emit(event: Any) -> None:
        for observer in observers:
            observer.notify(event)

    pipeline = Pipeline(config, emit=emit, should_stop=before_step)
    steering = Steering(pipeline, emit=emit, folder=folder, sources=[viewer.take_commands])
    try:
        pipeline._train(None)
    finally:
        looking.change(LOOKS[0], viewer)
        for observer in observers:
            observer.close()
    return out


class Looking:
    """Opens and closes clients of the page at ``port``."""

    def __init__(self, port: int):
        self._port = port
        self._client = None
        self._ends = threading.Event()

    def change(self, look: str, viewer: Any) -> None:
        """From now on ``look`` is who looks; returns when the viewer has noticed."""
        if self._client is not None:
            self._ends.set()
            self._client.close()
            self._client = None
            _until(lambda: viewer.watching == 0)
        if look == LOOKS[0]:
            return
        self._client = _connect(self._port)
        self._ends = threading.Event()
        if look == LOOKS[1]:
            threading.Thread(target=_take_all, args=(self._client, self._ends), daemon=True).start()
        _until(lambda: viewer.watching == 1)


def _connect(port: int) -> Any:
    """A client of the page, which the server takes for a browser once it has told where its camera is."""
    import msgspec
    import viser
    import viser._messages as messages
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocol = Subprotocol(f"viser-v{viser.__version__}")
    _until(lambda: _answers(port))
    client = connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None, compression=None)
    camera = messages.ViewerCameraMessage(
        wxyz=(1.0, 0.0, 0.0, 0.0),
        position=(0.0, 0.0, -3.0),
        fov=1.0,
        near=0.01,
        far=100.0,
        image_height=600,
        image_width=800,
        look_at=(0.0, 0.0, 0.0),
        up_direction=(0.0, 0.0, 1.0),
    )
    client.send(msgspec.msgpack.encode(camera.as_serializable_dict([])))
    return client


def _take_all(client: Any, ends: threading.Event) -> None:
    """In a thread of the measuring process: what it costs is counted against the viewer, too."""
    from websockets.exceptions import ConnectionClosed

    while not ends.is_set():
        try:
            client.recv(timeout=1.0)
        except TimeoutError:
            continue
        except ConnectionClosed:
            return


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


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
