"""Half a million faces and a million Gaussians: what a browser is sent, and what one that is slow is spared."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import viser

from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.testing.large_surface import large_snapshot
from sculpt_framework.testing.viewer_client import announce, connected, received_bytes
from sculpt_framework.viewing.colors import COLORS, KEYS, paint
from sculpt_framework.viewing.frames import Frame, frame_of
from sculpt_framework.viewing.html import write_html
from sculpt_framework.viewing.layers import show_cells, show_mesh, show_splats, show_wireframe
from sculpt_framework.viewing.server import start_server, stop_server
from sculpt_framework.viewing.stage import SPLATS_AT_MOST, USUAL_SPLATS

from .runs import make_run

MEGABYTES_AT_MOST = 13.0
"""For a layer: a second over an SSH tunnel of 100 Mbit/s."""


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of(large_snapshot(500_000, 2), outer=1, t_train=0.0)


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = start_server("127.0.0.1", 0)
    yield server
    stop_server(server)


def test_the_large_surface_is_one():
    snapshot = large_snapshot(2_000, 3)
    vertices, faces = snapshot.surface.vertices.double().numpy(), snapshot.surface.faces.numpy()
    certificate = certify(vertices, faces)
    assert certificate.watertight
    assert certificate.genus == 0
    assert snapshot.gaussians is not None
    assert snapshot.cells is not None
    assert len(snapshot.gaussians) == 3 * len(faces)
    grid = snapshot.cells.grid
    low, side = np.array(grid.origin), grid.cell
    assert (np.abs(vertices) < 1).all()
    assert (low + side * np.array(grid.shape) > 0.9).all()


@pytest.mark.slow
def test_no_layer_is_more_than_a_second_of_a_slow_line(frame: Frame, server: viser.ViserServer):
    assert len(frame.faces) > 490_000
    assert frame.gaussians is not None
    assert len(frame.gaussians) > 980_000
    assert frame.cells is not None
    sent = []
    with connected(f"http://127.0.0.1:{server.get_port()}") as client:
        announce(client)
        received_bytes(client, 0.5, first=60.0)
        for show in (
            lambda: show_mesh(server.scene, paint(frame, COLORS, None, ())),
            lambda: show_mesh(server.scene, paint(frame, KEYS, None, ())),
            lambda: show_wireframe(server.scene, frame),
            lambda: show_splats(server.scene, frame.gaussians, SPLATS_AT_MOST[USUAL_SPLATS]),
            lambda: show_cells(server.scene, frame.cells),
        ):
            show()
            sent.append(sum(map(len, received_bytes(client, 1.0, first=60.0))) / 1e6)
    assert min(sent) > 1.0
    assert max(sent) < MEGABYTES_AT_MOST, sent


def test_a_browser_that_was_away_gets_the_newest_alone(frame: Frame, server: viser.ViserServer):
    painted = paint(frame, COLORS, None, ())
    for _ in range(5):
        show_mesh(server.scene, painted)
    with connected(f"http://127.0.0.1:{server.get_port()}") as client:
        announce(client)
        sent = sum(map(len, received_bytes(client, 1.0, first=60.0))) / 1e6
    assert 1.0 < sent < MEGABYTES_AT_MOST


def test_a_page_to_send_has_fewer_steps_of_large_surfaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    run = make_run(tmp_path)
    monkeypatch.setattr("sculpt_framework.viewing.html.FACES_AT_MOST", 10)  # of 8 a step
    assert write_html(run, tmp_path / "few.html") == 2
