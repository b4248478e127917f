"""The run's end of the viewer: it starts the page's process, leaves it snapshots, takes its commands, ends it."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from sculpt_framework import registry
from sculpt_framework.commands import Pause, TakeSnapshot, command_to_json
from sculpt_framework.errors import ConfigError
from sculpt_framework.events import Event
from sculpt_framework.geometry.grid import Grid, pack
from sculpt_framework.serialization import config_to_json
from sculpt_framework.snapshot import Cells, Snapshot
from sculpt_framework.types import Box, Gaussians, Surface
from sculpt_framework.viewing.frames import read_frame, step_files
from sculpt_plugins.observers.recorder.config import RecorderConfig
from sculpt_plugins.observers.viser import observer as observer_module
from sculpt_plugins.observers.viser.config import ViserConfig
from sculpt_plugins.observers.viser.observer import ViserObserver
from tests.viewer.training import free_port


def event(name: str, outer: int = 7, t_train: float = 2.0, **data: object) -> Event:
    return Event(t_train=t_train, t_wall=3.0, outer=outer, event=name, data=data)


def tetrahedron() -> Snapshot:
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = torch.tensor([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    return Snapshot(
        surface=Surface(vertices=vertices, faces=faces, face_keys=torch.arange(4)),
        gaussians=Gaussians(
            means=vertices[faces].mean(dim=1),
            scales=torch.full((4, 3), 0.1),
            rotations=torch.eye(3).expand(4, 3, 3),
            opacities=torch.full((4,), 0.99),
            sh=torch.zeros(4, 1, 3),
            face=torch.arange(4),
        ),
        box=Box(minimum=torch.full((3,), -2.0), maximum=torch.full((3,), 2.0)),
        cells=Cells(
            grid=Grid(origin=(-1.0, -1.0, -1.0), base_shape=(4, 4, 4), base_cell=0.5),
            keys=pack(0, torch.tensor([[1, 1, 1], [2, 2, 2]])),
        ),
    )


def eventually(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    config = replace(registry.load_method("gaussian-sculpting-tiny")(), data="demo", observers=(RecorderConfig(),))
    (tmp_path / "config.json").write_text(config_to_json(config), encoding="utf-8")
    return tmp_path


Start = Callable[[ViserConfig, Path], "subprocess.Popen[str]"]


class Started:
    """The page's process, once there is one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, start: Start):
        self.process: subprocess.Popen[str]

        def starting(config: ViserConfig, run_dir: Path) -> "subprocess.Popen[str]":
            self.process = start(config, run_dir)
            return self.process

        monkeypatch.setattr(observer_module, "start_page", starting)


def scripted(monkeypatch: pytest.MonkeyPatch, *lines: object) -> Started:
    """In place of the page: a process that says ``lines``, then waits for the end of its input."""
    said = "".join(json.dumps(line) + "\n" for line in lines)
    script = f"import sys; sys.stdout.write({said!r}); sys.stdout.flush(); sys.stdin.read()"

    def start(config: ViserConfig, run_dir: Path) -> "subprocess.Popen[str]":
        pipe = subprocess.PIPE
        return subprocess.Popen([sys.executable, "-c", script], stdin=pipe, stdout=pipe, text=True, encoding="utf-8")

    return Started(monkeypatch, start)


@pytest.fixture
def watched(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ViserObserver]:
    """A viewer with one browser, whose process is scripted."""
    scripted(monkeypatch, {"command": command_to_json(Pause())}, {"watching": 1})
    observer = ViserObserver(ViserConfig(port=free_port(), seconds=0.0), run_dir)
    eventually(lambda: observer.watching == 1)
    yield observer
    observer.close()


def test_commands_of_the_page_reach_the_run_once(watched: ViserObserver):
    assert watched.take_commands() == [Pause(), TakeSnapshot()]
    # What has been asked for is on its way; asking again would be for nothing.
    assert watched.take_commands() == []


def test_a_snapshot_is_left_for_the_page(watched: ViserObserver, run_dir: Path):
    watched.take_commands()
    watched.notify(event("snapshot", snapshot=tetrahedron()))
    live = run_dir / "evolution" / "live.npz"
    eventually(live.exists)
    frame = read_frame(live)
    assert (frame.outer, frame.t_train) == (7, 2.0)
    assert frame.faces.shape == (4, 3)
    assert frame.vertices.max() == 2.0
    assert frame.gaussians is not None
    assert frame.cells is not None
    assert frame.cells.side.tolist() == [1.0, 1.0]
    eventually(lambda: [outer for outer, _ in step_files(run_dir)] == [7])


def test_steps_are_kept_less_and_less_often(watched: ViserObserver):
    asked = []
    watched.watching = 0
    for tenths in range(1, 600):
        watched.notify(event("outer_step", outer=tenths, t_train=tenths / 10))
        if TakeSnapshot() in watched.take_commands():
            asked.append(tenths / 10)
            watched.notify(event("snapshot", outer=tenths, t_train=tenths / 10, snapshot=tetrahedron()))
    early, late = [t for t in asked if t < 6], [t for t in asked if t > 6]
    assert len(early) == pytest.approx(len(late), abs=3)
    assert 25 < len(asked) < 45


def test_nobody_looking_costs_nothing(watched: ViserObserver):
    watched.take_commands()
    watched.notify(event("snapshot", snapshot=tetrahedron()))
    watched.watching = 0
    watched.notify(event("outer_step", outer=8, t_train=2.001))
    assert watched.take_commands() == []


def test_training_does_not_wait_for_the_page(watched: ViserObserver, monkeypatch: pytest.MonkeyPatch):
    told, ended = threading.Event(), []
    monkeypatch.setattr(observer_module, "write_frame", lambda *a, **k: ended.append(told.wait(60.0)))
    for _ in range(200):
        watched.notify(event("snapshot", snapshot=tetrahedron()))
    assert ended == [], "a snapshot has been waited for"
    told.set()


def test_nonsense_from_the_page_is_passed_over(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    scripted(monkeypatch, {"command": {"do": "explode"}}, ["?"], {"watching": 2})
    observer = ViserObserver(ViserConfig(port=free_port()), run_dir)
    eventually(lambda: observer.watching == 2)
    observer.close()
    assert "is no command" in caplog.text


def test_a_page_that_dies_leaves_the_run_alone(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    page = scripted(monkeypatch, {"watching": 1})
    observer = ViserObserver(ViserConfig(port=free_port()), run_dir)
    eventually(lambda: observer.watching == 1)
    page.process.kill()
    eventually(lambda: observer.watching == 0)
    eventually(lambda: "sculpt-view" in caplog.text)
    observer.notify(event("snapshot", snapshot=tetrahedron()))
    observer.close()


def test_a_page_that_hangs_is_ended(run_dir: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(observer_module, "LAST_WORDS_SECONDS", 0.3)
    page = scripted(monkeypatch, {"watching": 1})
    observer = ViserObserver(ViserConfig(port=free_port()), run_dir)
    eventually(lambda: observer.watching == 1)
    os.kill(page.process.pid, signal.SIGSTOP)
    observer.close()
    assert page.process.returncode == -signal.SIGKILL


def test_the_real_page_answers_and_goes_with_the_run(run_dir: Path, monkeypatch: pytest.MonkeyPatch):
    # A machine may be busy; what counts is that it ends by itself.
    monkeypatch.setattr(observer_module, "LAST_WORDS_SECONDS", 120.0)
    page, port = Started(monkeypatch, observer_module.start_page), free_port()
    observer = ViserObserver(ViserConfig(port=port), run_dir)
    eventually(lambda: observer.address is not None)
    assert observer.address == f"http://127.0.0.1:{port}"
    with urllib.request.urlopen(observer.address, timeout=30) as answer:
        assert b"<html" in answer.read()
    observer.close()
    assert page.process.returncode == 0
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def test_the_viewer_needs_the_recorder(run_dir: Path):
    config = replace(registry.load_method("gaussian-sculpting-tiny")(), observers=(ViserConfig(),))
    (run_dir / "config.json").write_text(config_to_json(config), encoding="utf-8")
    with pytest.raises(ConfigError, match="--observers viser recorder"):
        ViserObserver(ViserConfig(port=free_port()), run_dir)


def test_a_taken_port_is_one_clear_line(run_dir: Path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigError) as error:
            ViserObserver(ViserConfig(port=port), run_dir)
    assert str(error.value).startswith(f"the viewer cannot listen on 127.0.0.1:{port} (Address already in use)")
    assert "--observers.viser.port" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("host", ["0.0.0.0", "203.0.113.7", "::", "example.org"])
def test_other_machines_are_shown_the_tunnel_instead(run_dir: Path, host: str):
    with pytest.raises(ConfigError, match=r"ssh -L 7007:127\.0\.0\.1:7007 .*, then open http://127\.0\.0\.1:7007"):
        ViserObserver(ViserConfig(host=host), run_dir)


def test_a_port_that_is_none_is_one_clear_line(run_dir: Path):
    with pytest.raises(ConfigError, match="the viewer cannot listen on"):
        ViserObserver(ViserConfig(port=70_000), run_dir)


def test_a_small_mesh_in_map_coordinates_is_shown_as_it_is():
    vertices = np.array([[5.2e6, 4.1e5, 100.0], [5.2e6 + 0.2, 4.1e5, 100.0], [5.2e6, 4.1e5 + 0.1, 100.0]])
    shown = Snapshot.of_mesh(vertices, np.array([[0, 1, 2]]), torch.zeros(3, 3))
    np.testing.assert_allclose(shown.box.to_world(shown.surface.vertices.double()).numpy(), vertices, atol=1e-6)
