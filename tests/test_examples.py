"""The examples run, with the smallest method on a small scene."""

import json
import runpy
import sys
from pathlib import Path

import pytest
import trimesh

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object

EXAMPLES = Path(__file__).parents[1] / "examples"
TINY = ("--method", "gaussian-sculpting-tiny")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("examples") / "blob"
    write_scene(demo_object("blob"), DemoSettings(train_views=11, test_views=1, resolution=48, reference_cells=32), out)
    return out


def run(monkeypatch: pytest.MonkeyPatch, name: str, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", [name, *(str(word) for word in words)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_none_is_left_out():
    assert [path.name[0] for path in sorted(EXAMPLES.glob("*.py"))] == ["1", "2", "3", "4", "5"]
    page = (EXAMPLES.parent / "docs" / "guide" / "examples.md").read_text(encoding="utf-8")
    assert all(f"`examples/{path.name}`" in page for path in EXAMPLES.iterdir())


def test_a_mesh_of_a_folder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    words = ("--data", folder, "--out", tmp_path / "out", *TINY, "--seconds", 8)
    run(monkeypatch, "1_mesh_of_a_folder.py", *words)
    told = capsys.readouterr().out
    assert "watertight: True, pieces: 1" in told
    assert "Chamfer distance: 0." in told
    assert (tmp_path / "out" / "mesh.ply").is_file()


def test_step_by_step_stops_when_it_is_good_enough(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    words = ("--data", folder, "--out", tmp_path, *TINY, "--steps", 500, "--enough", 5)
    run(monkeypatch, "2_step_by_step.py", *words)
    told = capsys.readouterr().out
    assert told.count("\nstep ") < 5, "it went on"
    assert trimesh.load_mesh(tmp_path / "mesh.ply").is_watertight
    assert (tmp_path / "beside.png").is_file()


@pytest.mark.slow
def test_a_scene_from_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    words = ("--out", tmp_path / "torus.ply", *TINY, "--views", 16, "--side", 64, "--seconds", 20)
    run(monkeypatch, "3_scene_from_arrays.py", *words)
    distance = float(capsys.readouterr().out.partition("faces, ")[2].partition(" ")[0])
    assert distance < 0.03
    assert trimesh.load_mesh(tmp_path / "torus.ply").is_watertight


@pytest.mark.slow
def test_a_loss_of_ones_own(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    run(monkeypatch, "4_own_loss.py", "--data", folder, *TINY, "--weight", 3, "--seconds", 8)
    without, own = (float(line.split(": ")[1].split()[0]) for line in capsys.readouterr().out.splitlines())
    assert own < 0.98 * without


@pytest.mark.slow
def test_methods_beside_each_other(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    methods = ("gaussian-sculpting-tiny", "splatting-3d")
    words = ("--data", folder, "--methods", *methods, "--seconds", 10, "--out", tmp_path / "chart.png")
    run(monkeypatch, "5_methods_beside_each_other.py", *words)
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[:2]] == list(methods)
    assert (tmp_path / "chart.png").is_file()


def test_the_notebook(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    cells = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    assert all(not cell.get("outputs") for cell in cells), "saved without what it printed"
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            code = "".join(cell["source"]).replace('"demo"', repr(str(folder)))
            code = code.replace('"gaussian-sculpting", 60', '"gaussian-sculpting-tiny", 8')
            exec(compile(code, cell["id"], "exec"), names)
    assert "11 views, 48 pixels wide" in capsys.readouterr().out
    assert trimesh.load_mesh(tmp_path / "blob.ply").is_watertight
