"""The run directory."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine import output
from sculpt_framework.engine.output import check_output, prepare_output, scene_name
from sculpt_framework.errors import OutputError

pytestmark = pytest.mark.usefixtures("fake")


def config(**changes: object) -> MethodConfig:
    return replace(registry.load_method("fake")(), data="demo", **changes)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("data", "name"),
    [("demo", "demo"), ("demo:knot", "knot"), ("a/b/jar", "jar"), ("a/jar/", "jar"), ("/", "scene"), ("jar/..", None)],
)
def test_scene_name(data: str, name: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert scene_name(data) == (name or tmp_path.name)


def test_scene_names_are_fit_for_a_folder():
    assert scene_name("demo:../../etc") == "etc"
    assert scene_name("/x/my jar: new") == "my-jar-new"
    assert scene_name("/x/Krug-Ümläut") == "Krug-Ümläut"
    assert len(scene_name("/x/" + "y" * 200)) == 100


def test_by_default_runs_are_sorted_by_scene_method_and_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    first, second = prepare_output(config()), prepare_output(config())
    assert first != second
    for folder in (first, second):
        assert folder.parent == Path("outputs/demo/fake")
        assert folder.is_dir()
        assert not any(folder.iterdir())


def test_two_runs_in_one_second_get_two_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    names = {prepare_output(config()).name for _ in range(5)}
    assert len(names) == 5


@pytest.mark.parametrize("exists", [False, True])
def test_an_empty_or_new_folder_is_taken(tmp_path: Path, exists: bool):
    folder = tmp_path / "a" / "b"
    if exists:
        folder.mkdir(parents=True)
    check_output(config(output=folder))
    assert folder.exists() == exists
    assert prepare_output(config(output=folder)) == folder
    assert list(folder.iterdir()) == []


def test_a_folder_with_something_in_it_is_not(tmp_path: Path):
    (tmp_path / "mesh.ply").touch()
    with pytest.raises(OutputError, match=f"--output {tmp_path} is not empty. Give a new folder, or --resume"):
        prepare_output(config(output=tmp_path))


@pytest.mark.parametrize("below", ["", "deep/er"])
def test_a_file_is_no_folder(tmp_path: Path, below: str):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file is not a folder\.$"):
        prepare_output(config(output=tmp_path / "file" / below))


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # The superuser may write anywhere, so the answer of the system is played here.
    monkeypatch.setattr(output.os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match=rf"no permission in {tmp_path}\.$"):
        check_output(config(output=tmp_path / "new"))


def test_a_system_that_refuses_is_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(28, os.strerror(28), str(tmp_path))

    monkeypatch.setattr(output.tempfile, "TemporaryFile", full)
    with pytest.raises(OutputError, match="No space left on device"):
        prepare_output(config(output=tmp_path / "run"))


def test_a_name_no_file_system_takes(tmp_path: Path):
    with pytest.raises(OutputError, match="File name too long"):
        prepare_output(config(output=tmp_path / ("x" * 300)))
