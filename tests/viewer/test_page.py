"""The page as a client of its protocol sees it: what is shown, what its controls send, whom it refuses."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import viser._messages as messages
from websockets.exceptions import ConnectionClosed

from sculpt_framework import registry
from sculpt_framework.commands import (
    AddBox,
    ClearBoxes,
    Command,
    Pause,
    SetRate,
    SetWeight,
    Stop,
    SwitchConstraint,
)
from sculpt_framework.engine.run import run
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.testing.viewer_client import announce, connected, given, received, send
from sculpt_framework.types import Scene
from sculpt_framework.viewing.address import check_address
from sculpt_framework.viewing.frames import FOLDER, LIVE, step_files, write_frame
from sculpt_framework.viewing.html import write_html
from sculpt_framework.viewing.run_folder import RunFolder
from sculpt_framework.viewing.show import Show
from sculpt_plugins.observers.viser.config import ViserConfig

from .runs import make_run, octahedron


def eventually(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture
def sent() -> list[Command]:
    return []


def no_photographs(run: RunFolder) -> Scene:
    raise DataError("they are gone")


@pytest.fixture
def show(tmp_path: Path, sent: list[Command], monkeypatch: pytest.MonkeyPatch) -> Iterator[Show]:
    monkeypatch.setattr(RunFolder, "load_scene", no_photographs)
    show = Show(make_run(tmp_path), "127.0.0.1", 0, sent.append)
    yield show
    show.close()


def address(show: Show) -> str:
    return f"http://127.0.0.1:{show.port}"


def told(show: Show) -> list[dict]:
    with connected(address(show)) as client:
        return received(client, 0.4, first=5.0)


def text_of(show: Show) -> str:
    """What a browser that opens the page has to read."""
    show.update()
    return str([each for each in told(show) if each["type"].startswith("Gui")])


def names(told: list[dict]) -> set[str]:
    return {message["name"] for message in told if message["type"] != "RemoveSceneNodeMessage" and "name" in message}


def test_the_page_shows_the_run(show: Show):
    eventually(lambda: "No photographs: they are gone" in text_of(show))
    messages_, text = told(show), text_of(show)
    for words in ("**shape** by *tiny*", "Step 20, 2 s of training, about 8 s left", "8 faces, 8 Gaussians, 100 MB"):
        assert words in text
    assert "chamfer_ps 0.01, psnr 21.5" in text
    assert "decision: item initial surface, value Sphere" in text
    assert "After 20 steps, 2.0 s of training: 8 faces, 8 Gaussians." in text
    assert {"/mesh", "/box"} <= names(messages_)
    assert "/gaussians" not in names(messages_)
    assert sum(each["type"] == "GuiUplotMessage" for each in messages_) == 3


def test_what_was_planned_stands_before_what_was_decided(show: Show):
    row = {"item": "views", "value": "80 of 100", "evidence": "20 see nothing", "override": "--plan.views off"}
    show.overview.hear([{"event": "plan", "t_train": 0.0, "outer": 0, "data": {"decisions": [row], "kept": []}}])
    show.update()
    first, second = show.overview.plan.content.splitlines()
    assert first == "- plan, views: 80 of 100; 20 see nothing (`--plan.views off` takes it back)"
    assert "initial surface" in second


def test_a_method_without_gaussians_is_shown(show: Show):
    step = {"progress": 0.3, "loss": 0.05, "faces": 9, "rss_mb": 101.0, "psnr": None, "eta_s": None, "stretches": 7}
    show.overview.hear([{"event": "outer_step", "t_train": 3.0, "outer": 30, "data": step}])
    assert "9 faces, 101 MB, loss 0.05" in show.overview.text.content


def test_names_and_messages_are_shown_as_they_are(show: Show):
    bad = "<img src=x onerror=alert(1)> *a* ![b](c)\n\n# d"
    said = r"\<img src=x onerror=alert(1)\> \*a\* \!\[b\](c) \# d"
    row = {"item": bad, "value": bad, "evidence": bad, "override": "`<b>`"}
    show.run.started = {"scene": bad, "method": bad}
    show.overview.hear(
        [
            {"event": "plan", "t_train": 0.0, "outer": 0, "data": {"decisions": [row], "kept": []}},
            {"event": "warning", "t_train": 0.0, "outer": 0, "data": {"message": bad}},
            {"event": "decision", "t_train": 0.0, "outer": 0, "data": {"item": bad}},
        ]
    )
    assert show.overview.text.content.startswith(f"**{said}** by *{said}*")
    assert show.overview.plan.content.splitlines()[-3:] == [
        f"- plan, {said}: {said}; {said} (`<b>` takes it back)",
        f"- 0.0 s, warning: {said}",
        f"- 0.0 s, decision: item {said}",
    ]
    show.stage.do_without_scene(bad)
    assert repr(f"No photographs: {said}")[1:-1] in str(told(show))


def test_switches_add_layers(show: Show):
    show.update()
    for name in ("wireframe", "gaussians", "cells"):
        show.stage.switches[name].value = True
    show.update()
    assert {"/wireframe", "/gaussians", "/cells", "/cells/level-1"} <= names(told(show))
    show.stage.switches["mesh"].value = False
    show.update()
    hidden = [
        each for each in told(show) if each["type"] == "SetSceneNodeVisibilityMessage" and each["name"] == "/mesh"
    ]
    assert [each["visible"] for each in hidden] == [False]


def test_a_newer_state_replaces_the_older(show: Show, tmp_path: Path):
    assert "After 20 steps" in text_of(show)
    write_frame(tmp_path / FOLDER / LIVE, octahedron(1.1), outer=30, t_train=3.0, whole=True)
    assert "After 30 steps" in text_of(show)


def test_the_slider_goes_back_in_time(show: Show, tmp_path: Path):
    show.update()
    change(show, "GuiSliderMessage", "Step", 0)
    assert "After 1 steps, 0.1 s of training" in text_of(show)
    # It stays there whatever the run does, until it is moved back to the end.
    write_frame(tmp_path / FOLDER / LIVE, octahedron(1.1), outer=30, t_train=3.0, whole=True)
    assert "After 1 steps" in text_of(show)
    change(show, "GuiSliderMessage", "Step", len(step_files(tmp_path)))
    assert "After 30 steps" in text_of(show)


def press(show: Show, label: str) -> None:
    """Press the button with this label as a browser does."""
    change(show, "GuiButtonMessage", label, True)


def change(show: Show, kind: str, label: str, value: object) -> None:
    """Give the control of this kind and label a value as a browser does."""
    with given(address(show), kind, label, value):
        time.sleep(0.3)


def test_controls_send_commands(show: Show, sent: list[Command]):
    press(show, "Pause")
    eventually(lambda: sent == [Pause()])
    press(show, "Stop and save")
    eventually(lambda: sent == [Pause(), Stop()])


@pytest.mark.parametrize(
    ("kind", "label", "value", "command"),
    [
        ("GuiNumberMessage", "eikonal", 0.5, SetWeight(slot="losses", name="eikonal", weight=0.5)),
        ("GuiNumberMessage", "spacing", 2.0, SetWeight(slot="constraints", name="spacing", weight=2.0)),
        ("GuiCheckboxMessage", "spacing", False, SwitchConstraint(name="spacing", on=False)),
        ("GuiSliderMessage", "Of the surface, times", 0.5, SetRate(part="surface", factor=0.5)),
        ("GuiSliderMessage", "Of the gaussians, times", 2.0, SetRate(part="gaussians", factor=2.0)),
    ],
)
def test_numbers_and_switches_send_commands(
    show: Show, sent: list[Command], kind: str, label: str, value: object, command: Command
):
    change(show, kind, label, value)
    eventually(lambda: sent == [command])


@pytest.mark.parametrize("kind", ["refine", "freeze", "ignore"])
def test_a_box_is_for_what_its_button_says(show: Show, sent: list[Command], kind: str):
    show.update()
    press(show, "Place a box")
    press(show, f"{kind.capitalize()} here")
    eventually(lambda: len(sent) == 1)
    (command,) = sent
    assert isinstance(command, AddBox)
    assert command.kind == kind
    press(show, "Take all boxes back")
    eventually(lambda: sent == [command, ClearBoxes()])


def test_a_box_is_sent_in_world_frame(show: Show, sent: list[Command]):
    show.update()
    press(show, "Place a box")
    change(show, "GuiVector3Message", "Sides", (1.0, 2.0, 4.0))
    with connected(address(show)) as client:
        announce(client)
        eventually(lambda: show.watching == 1)
        moved = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 1.0, 2.0)}
        send(client, messages.TransformControlsUpdateMessage(name="/gizmo", **moved))
        received(client, 0.7)
    press(show, "Refine here")
    eventually(lambda: len(sent) == 1)
    (command,) = sent
    assert isinstance(command, AddBox)
    assert (command.kind, command.minimum, command.maximum) == ("refine", (-0.5, 0.0, 0.0), (0.5, 2.0, 4.0))


def test_two_browsers_see_the_same_and_are_counted(show: Show):
    show.update()
    with connected(address(show)) as first, connected(address(show)) as second:
        announce(first)
        announce(second)
        eventually(lambda: show.watching == 2)
        assert names(received(first, 0.7)) == names(received(second, 0.7))
        first.close()
        eventually(lambda: show.watching == 1)


def test_pages_of_other_sites_are_refused(show: Show):
    show.update()
    with connected(address(show), origin="https://example.org") as client, pytest.raises(ConnectionClosed):
        received(client, 5.0)
    with connected(address(show), origin=address(show)) as client:
        assert received(client, 0.7)


def test_a_browser_cannot_have_the_page_shared(show: Show, monkeypatch: pytest.MonkeyPatch):
    asked = []
    monkeypatch.setattr(show.server, "request_share_url", lambda *a, **k: asked.append(1))
    with connected(address(show)) as client:
        announce(client)
        send(client, messages.ShareUrlRequest())
        send(client, messages.ShareUrlDisconnect())
        eventually(lambda: show.watching == 1)
        time.sleep(0.2)
    assert not asked


def test_a_page_in_one_file_needs_no_server(tmp_path: Path):
    out = tmp_path / "evolution.html"
    assert write_html(make_run(tmp_path), out) == 3
    text = out.read_text(encoding="utf-8")
    assert "__VISER_EMBED_DATA__" in text
    assert "<script src=" not in text
    assert 'rel="stylesheet" href=' not in text


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["nowhere"], "error: nowhere is not a run directory: it has no config.json"),
        (["RUN", "--host", "0.0.0.0"], "ssh -L 7007:127.0.0.1:7007"),
        (["RUN", "--port", "70000"], "choose another --port"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(tmp_path: Path, words: list[str], complaint: str):
    run = str(make_run(tmp_path))
    words = [run if word == "RUN" else word for word in words]
    done = subprocess.run(
        [sys.executable, "-m", "sculpt_framework.cli.view", *words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 2
    assert complaint in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_port_that_is_taken_is_said_before_a_run_has_a_folder(show: Show, tmp_path: Path):
    config = ViserConfig(port=show.port)
    folder = tmp_path / "new"
    method = replace(registry.load_method("gaussian-sculpting-tiny")(), data="demo", output=folder, observers=(config,))
    with pytest.raises(ConfigError, match=rf"127.0.0.1:{show.port} \(.*choose another --observers.viser.port") as error:
        run(method, resume=None, started=0.0)
    assert "\n" not in str(error.value)
    assert not folder.exists()


def test_a_machine_without_this_kind_of_address_says_so_in_one_line(monkeypatch: pytest.MonkeyPatch):
    def refuse(*arguments: object) -> None:
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr("sculpt_framework.viewing.address.socket.socket", refuse)
    with pytest.raises(ConfigError, match=r"cannot listen on ::1:7007 \(Address family .*choose another --port"):
        check_address("::1", 7007, "--port")


def test_a_run_without_a_viewer_imports_none_of_it():
    script = "import sculpt_framework.engine.run, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True, encoding="utf-8"
    )
    names = done.stdout.split()
    assert "sculpt_framework.engine.steering" in names
    assert not [
        name for name in names if name.split(".")[0] == "viser" or "viewing" in name or "observers.viser" in name
    ]
