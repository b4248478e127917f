"""What the page of a large surface costs: CPU seconds to make each layer and megabytes that every browser is sent.

    python docs/measure_page.py [--faces N] [--gaussians-per-face N]

The viewer's own process does this work, on one thread; training does not wait for it.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from sculpt_framework.testing.large_surface import large_snapshot
from sculpt_framework.testing.viewer_client import announce, connected, received_bytes
from sculpt_framework.viewing.colors import COLORS, QUALITY, paint
from sculpt_framework.viewing.frames import read_frame, write_frame
from sculpt_framework.viewing.layers import show_cells, show_mesh, show_splats, show_wireframe
from sculpt_framework.viewing.server import start_server, stop_server
from sculpt_framework.viewing.stage import SPLATS_AT_MOST, USUAL_SPLATS

_SILENCE_SECONDS = 1.0


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--faces", type=int, default=500_000)
    options.add_argument("--gaussians-per-face", type=int, default=2)
    chosen = options.parse_args()
    snapshot = large_snapshot(chosen.faces, chosen.gaussians_per_face)
    sys.stdout.write(f"{len(snapshot.surface.faces)} faces, {chosen.faces * chosen.gaussians_per_face} Gaussians\n\n")
    sys.stdout.write("| what | CPU s | MB |\n|---|---|---|\n")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.npz"
        seconds = _timed(lambda: write_frame(path, snapshot, outer=1, t_train=0.0, whole=True))
        sys.stdout.write(f"| snapshot written (by a thread of the run) | {seconds:.2f} | {_mb(path)} |\n")
        began = time.process_time()
        frame = read_frame(path)
        sys.stdout.write(f"| snapshot read | {time.process_time() - began:.2f} | |\n")
    gaussians, cells = frame.gaussians, frame.cells
    assert gaussians is not None  # noqa: S101
    assert cells is not None  # noqa: S101
    server = start_server("127.0.0.1", 0)
    scene = server.scene
    layers: dict[str, Callable[[], object]] = {
        "mesh, a colour at each vertex": lambda: show_mesh(scene, paint(frame, COLORS, None, ())),
        "mesh, a colour for each face": lambda: show_mesh(scene, paint(frame, QUALITY, None, ())),
        "wireframe": lambda: show_wireframe(scene, frame),
        "grid cells": lambda: show_cells(scene, cells),
        f"Gaussians, at most {USUAL_SPLATS}": lambda: show_splats(scene, gaussians, SPLATS_AT_MOST[USUAL_SPLATS]),
        "Gaussians, all": lambda: show_splats(scene, gaussians, len(gaussians)),
    }
    try:
        with connected(f"http://127.0.0.1:{server.get_port()}") as client:
            announce(client)
            received_bytes(client, _SILENCE_SECONDS)
            for name, show in layers.items():
                seconds = _timed(show)
                sent = sum(map(len, received_bytes(client, _SILENCE_SECONDS, first=60.0)))
                sys.stdout.write(f"| {name} | {seconds:.2f} | {sent / 1e6:.1f} |\n")
    finally:
        stop_server(server)


def _timed(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _mb(path: Path) -> str:
    return f"{path.stat().st_size / 1e6:.1f}"


if __name__ == "__main__":
    main()
