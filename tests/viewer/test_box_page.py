"""The page on which the box of a scene is chosen, as a client of its protocol sees it."""

import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from sculpt_framework.cli.data import data, write_demo
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.testing.viewer_client import announce, connected, find_control, received, set_control
from sculpt_framework.types import Box
from sculpt_framework.viewing.box_page import BoxPage
from sculpt_plugins.datasets.blender.config import BlenderConfig

from .training import eventually

FAR = (4.5e5, -2e5, 0.0)


@pytest.fixture
def page(tmp_path: Path) -> Iterator[BoxPage]:
    write_demo("blob", tmp_path / "blob", 8, 1, 64)
    scene = BlenderConfig().build(str(tmp_path / "blob")).load()
    # Far from the origin, where few digits of a coordinate say nothing of the box.
    shift = torch.tensor(FAR, dtype=torch.float64)
    box = Box(minimum=scene.box.minimum.double() + shift, maximum=scene.box.maximum.double() + shift)
    page = BoxPage(replace(scene, box=box), "127.0.0.1", 0)
    yield page
    page.close()


def test_sides_typed_in_are_the_box_that_is_returned(page: BoxPage):
    middle = page.box.center
    waiting = threading.Thread(target=page.wait, daemon=True)
    waiting.start()
    address = f"http://127.0.0.1:{page.port}"
    before = pictures_on(address)
    with connected(address) as client:
        announce(client)
        set_control(client, find_control(client, "GuiVector3Message", "Sides"), (0.5, 1.0, 1.5))
        eventually(lambda: sides_of(page) == pytest.approx([0.5, 1.0, 1.5]))
        # So far away the box is in no picture: the one that is chosen is the only one to be another.
        set_control(client, find_on(address, "GuiSliderMessage", "First photograph"), 3)
        eventually(lambda: any(redrawn(before, pictures_on(address))))
        after = pictures_on(address)
        set_control(client, find_on(address, "GuiButtonMessage", "Use this box"), True)
        waiting.join(20)
    assert not waiting.is_alive()
    assert redrawn(before, after) == [True, *[False] * 5]
    assert page.box.center.tolist() == pytest.approx(middle.tolist(), abs=1e-6)
    option, *numbers = page.words.split()
    assert option == "--dataset.box"
    corners = [*page.box.minimum.tolist(), *page.box.maximum.tolist()]
    assert [float(number) for number in numbers] == pytest.approx(corners, abs=1e-4)


def sides_of(page: BoxPage) -> list[float]:
    return (page.box.maximum - page.box.minimum).tolist()


def pictures_on(address: str) -> list[bytes]:
    """The photographs, as a browser gets them that opens the page."""
    pictures: dict[str, bytes] = {}
    with connected(address) as client:
        for message in received(client, 0.7):
            if message["type"] == "GuiImageMessage":
                pictures[message["uuid"]] = message["props"]["_data"]
            elif message["type"] == "GuiUpdateMessage" and message["uuid"] in pictures:
                pictures[message["uuid"]] = message["updates"]["_data"]
    return list(pictures.values())


def redrawn(before: list[bytes], after: list[bytes]) -> list[bool]:
    return [one != other for one, other in zip(before, after, strict=True)]


def find_on(address: str, kind: str, label: str) -> str:
    """As a browser finds it that opens the page."""
    with connected(address) as client:
        return find_control(client, kind, label)


def test_what_is_no_scene_has_no_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    no_page: Callable[..., BoxPage] = pytest.fail
    monkeypatch.setattr("sculpt_framework.viewing.box_page.BoxPage", no_page)
    monkeypatch.setattr("sys.argv", ["sculpt-data", "box", str(tmp_path)])
    with pytest.raises(DataError, match=re.escape(str(tmp_path))):
        data()


def test_a_layout_that_takes_no_box_is_told_before_there_is_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_demo("blob", tmp_path / "blob", 4, 1, 64)
    monkeypatch.setattr("sys.argv", ["sculpt-data", "box", str(tmp_path / "blob")])
    with pytest.raises(ConfigError, match=r"--dataset\.box is for photographs"):
        data()
