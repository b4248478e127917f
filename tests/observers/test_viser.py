"""The page in the browser: what it shows, that its switches work, that it goes away."""

import io
import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout

import numpy as np
import pytest
import torch
import viser
import zstandard
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from sculpt_framework.engine.events import Event
from sculpt_framework.engine.reconstruction import Reconstruction
from sculpt_framework.errors import ConfigError
from sculpt_framework.types import Gaussians
from sculpt_plugins.observers.viser.config import ViserConfig
from sculpt_plugins.observers.viser.viewer import ViserViewer

STEP = {"loss": 0.0123, "faces": 4}
STAGE = {"index": 0, "count": 3, "grid": [32, 32, 30]}


def event(name: str, **data: object) -> Event:
    return Event(t_train=2.0, t_wall=3.0, outer=7, event=name, data=data)


def tetrahedron(size: float = 1.0) -> Reconstruction:
    vertices = size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    gaussians = Gaussians(
        means=torch.from_numpy(vertices[faces].mean(axis=1)).float(),
        scales=torch.full((4, 3), 0.1),
        rotations=torch.eye(3).expand(4, 3, 3),
        opacities=torch.full((4,), 0.99),
        sh=torch.zeros(4, 1, 3),
        face=torch.arange(4),
    )
    return Reconstruction(
        vertices=vertices, faces=faces, colors=np.full((4, 3), 0.5, dtype=np.float32), gaussians=gaussians
    )


def eventually(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def received(viewer: ViserViewer, *words: bytes) -> bool:
    """Whether a browser that opens the page now is told all of ``words``."""
    address = viewer.address.replace("http", "ws")
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    missing = set(words)
    with connect(address, subprotocols=[protocol], max_size=None, compression=None) as browser:
        while missing:
            try:
                message = browser.recv(timeout=1.0)
            except TimeoutError:
                return False
            assert isinstance(message, bytes)
            told = _unpacked(message)
            missing = {word for word in missing if word not in told}
    return True


def _unpacked(message: bytes) -> bytes:
    """The names and texts in a message: two lengths of 8 bytes, then that much Zstandard; arrays follow."""
    return zstandard.decompress(message[16 : 16 + int.from_bytes(message[8:16], "little")])


@pytest.fixture
def viewer() -> Iterator[ViserViewer]:
    viewer = ViserViewer(ViserConfig(port=0))
    yield viewer
    viewer.close()


def test_the_page_answers(viewer: ViserViewer):
    with urllib.request.urlopen(viewer.address, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read()


def test_a_browser_gets_the_surface_and_the_figures(viewer: ViserViewer):
    viewer.notify(event("run_started", method="m"))
    viewer.notify(event("stage", **STAGE))
    viewer.notify(event("outer_step", **STEP))
    viewer.notify(event("evaluation", psnr=31.5, iou=None, chamfer_ps=0.002))
    viewer.notify(event("snapshot", reconstruction=tetrahedron()))
    words = (b"/mesh", b"/gaussians", b"32x32x30", b"loss 0.0123", b"psnr 31.5, chamfer_ps 0.002")
    eventually(lambda: received(viewer, *words))


def test_switches_show_and_hide(viewer: ViserViewer):
    viewer.notify(event("snapshot", reconstruction=tetrahedron()))
    eventually(lambda: viewer._splats is not None)
    assert (viewer._mesh.visible, viewer._splats.visible) == (True, False)
    viewer._show_mesh.value, viewer._show_splats.value = False, True
    eventually(lambda: (viewer._mesh.visible, viewer._splats.visible) == (False, True))
    shown = viewer._mesh
    viewer.notify(event("snapshot", reconstruction=tetrahedron(2.0)))
    eventually(lambda: viewer._mesh is not shown)
    assert (viewer._mesh.visible, viewer._splats.visible) == (False, True)


def test_an_empty_surface_is_not_sent(viewer: ViserViewer):
    nothing = tetrahedron()
    empty = Reconstruction(
        vertices=nothing.vertices[:0], faces=nothing.faces[:0], colors=nothing.colors[:0], gaussians=nothing.gaussians
    )
    viewer.notify(event("snapshot", reconstruction=empty))
    viewer.notify(event("outer_step", **STEP))
    eventually(lambda: "loss 0.0123" in viewer._text.content)
    assert viewer._mesh is None


def test_training_does_not_wait_for_browsers(viewer: ViserViewer):
    began = time.monotonic()
    for _ in range(1000):
        viewer.notify(event("snapshot", reconstruction=tetrahedron()))
    assert time.monotonic() - began < 1.0


def test_closing_sends_the_last_news_and_leaves_nothing_behind():
    before = set(threading.enumerate())
    viewer = ViserViewer(ViserConfig(port=0))
    port = int(viewer.address.rpartition(":")[2])
    viewer.notify(event("run_ended", status="finished"))
    said = io.StringIO()
    with redirect_stdout(said):
        viewer.close()
    assert "finished" in viewer._text.content
    assert said.getvalue() == ""
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0
    eventually(lambda: not set(threading.enumerate()) - before)


def test_a_taken_port_is_one_clear_line():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigError) as error:
            ViserViewer(ViserConfig(port=port))
    assert str(error.value).startswith(f"the viewer cannot listen on 127.0.0.1:{port} (Address already in use)")
    assert "--observers.viser.port" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("options", [{"host": "203.0.113.7"}, {"port": 70_000}])
def test_an_address_that_is_not_ours_is_one_clear_line(options: dict):
    with pytest.raises(ConfigError, match="the viewer cannot listen on"):
        ViserViewer(ViserConfig(**options))
