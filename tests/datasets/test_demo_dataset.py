"""From a demo scene to a folder and back, by way of the command line, the cache and the recognising dataset."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from plain_scenes import load, make_scene

from sculpt_framework.api import load as load_scene
from sculpt_framework.cli import data as command
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.folder import DemoSettings, cached_scene, write_scene
from sculpt_framework.demo_scenes.objects import OBJECTS
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.errors import ConfigError, DataError, OutputError
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.demo.config import DemoConfig

SMALL = DemoConfig(resolution=32, train_views=3, test_views=1)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_round_trip(demo_folder: Path) -> None:
    """What the loader reads is what was rendered: cameras to 1e-6, pixels to the last of 8 bits."""
    scene = load(demo_folder)
    assert (len(scene.train), len(scene.test)) == (8, 2)
    assert scene.reference_mesh == demo_folder / "gt_mesh.ply"
    for view, camera in zip(scene.train, demo_cameras(8, 80), strict=True):
        torch.testing.assert_close(view.camera.world_to_camera, camera.world_to_camera, rtol=0, atol=1e-6)
        for name in ("fx", "fy", "cx", "cy"):
            assert getattr(view.camera, name) == pytest.approx(getattr(camera, name), abs=1e-6)
        assert (view.camera.width, view.camera.height) == (80, 80)
    rgb, alpha = render(OBJECTS["blob"], demo_cameras(8, 80)[2])
    assert scene.train[2].alpha is not None
    np.testing.assert_allclose(scene.train[2].rgb.numpy(), rgb, atol=1 / 255)
    np.testing.assert_allclose(scene.train[2].alpha.numpy(), alpha, atol=1 / 255)


def test_box_holds_the_reference_mesh(demo_folder: Path) -> None:
    box = load(demo_folder).box
    mesh = trimesh.load_mesh(demo_folder / "gt_mesh.ply")
    assert (box.minimum.numpy() <= mesh.bounds[0]).all()
    assert (box.maximum.numpy() >= mesh.bounds[1]).all()
    assert box.scale < 1.3 * 0.5 * mesh.extents.max()
    colors = np.asarray(getattr(mesh.visual, "vertex_colors", None))  # Its type depends on the file.
    assert colors[:, :3].std(axis=0).min() > 10


def test_writing_never_overwrites(demo_folder: Path, tmp_path: Path) -> None:
    item, settings = OBJECTS["blob"], DemoSettings(train_views=1, test_views=0, resolution=16, reference_cells=16)
    with pytest.raises(OutputError, match=r"blob: exists and is not empty; give a new or an empty folder"):
        write_scene(item, settings, demo_folder)
    file = tmp_path / "file"
    file.write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"exists and is not empty"):
        write_scene(item, settings, file)
    with pytest.raises(OutputError, match=r"below: cannot be written"):
        write_scene(item, settings, file / "below")
    (tmp_path / "empty").mkdir()
    write_scene(item, settings, tmp_path / "empty")
    assert not (tmp_path / "empty" / "transforms_test.json").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "file"]


def test_an_empty_folder_is_written_where_names_that_are_taken_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse_taken(aside: Path, target: Path) -> Path:
        """As Windows renames folders."""
        if target.exists():
            raise FileExistsError(target)
        return aside.rename(target)

    monkeypatch.setattr(Path, "replace", refuse_taken)
    settings = DemoSettings(train_views=1, test_views=0, resolution=16, reference_cells=16)
    write_scene(OBJECTS["blob"], settings, tmp_path)
    assert (tmp_path / "gt_mesh.ply").is_file()


def test_interrupted_writing_leaves_nothing(tmp_path: Path) -> None:
    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_scene(
            OBJECTS["blob"], DemoSettings(train_views=2, resolution=16, reference_cells=16), tmp_path / "s", stop
        )
    assert list(tmp_path.iterdir()) == []


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    settings = DemoSettings(train_views=2, resolution=16, reference_cells=16)
    with pytest.raises(OutputError, match=r"s: cannot be written \(No space left on device\)"):
        write_scene(OBJECTS["blob"], settings, tmp_path / "s")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("field", "value", "what"),
    [("train_views", 0, "train-views"), ("test_views", -1, "test-views"), ("resolution", 9, "resolution")],
)
def test_impossible_settings(field: str, value: int, what: str) -> None:
    with pytest.raises(ConfigError, match=rf"--dataset\.{what} is {value}; expected"):
        load_scene("demo", DemoConfig(**{field: value}))


def test_demo_is_rendered_once_and_read_from_the_cache(cache: Path) -> None:
    scene = SMALL.build("demo:thin").load()
    assert scene.name == "thin"
    assert scene.train[0].rgb.shape == (32, 32, 3)
    assert scene.reference_mesh is not None
    assert scene.reference_mesh.is_relative_to(cache)
    assert scene.notes[0] == f"demo scene 'thin': {OBJECTS['thin'].summary}."
    stamp = scene.reference_mesh.stat().st_mtime_ns
    again = SMALL.build("demo:thin").load().reference_mesh
    assert again is not None
    assert again.stat().st_mtime_ns == stamp


def test_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    settings = DemoSettings(train_views=1, test_views=0, resolution=16, reference_cells=16)
    folder = cached_scene(OBJECTS["double-torus"], settings)
    assert (folder / "gt_mesh.ply").is_file()
    assert folder.is_relative_to(tmp_path)


def test_demo_names() -> None:
    with pytest.raises(
        DataError, match=r"there are blob, dents, thin, double-torus, gaps, machine, flask, .*; did you mean gaps\?"
    ):
        AutoDatasetConfig().build("demo:gap")
    with pytest.raises(DataError, match=r"scenes/jar: not a demo scene; expected demo or demo:NAME"):
        DemoConfig().build("scenes/jar")
    documented = DemoConfig.__doc__ or ""
    assert "sculpt-data list" in documented


def test_layout_is_recognised_and_named(tmp_path: Path) -> None:
    scene = AutoDatasetConfig().build(str(make_scene(tmp_path / "s"))).load()
    assert scene.notes[0] == "layout: NeRF-Synthetic (there is transforms_train.json)."
    assert len(scene.train) == 6


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("", r"no data given"),
        ("nowhere", r"nowhere: no such folder; expected a scene folder, or demo, or demo:NAME"),
        ("file", r"file: is a file; give the folder it is in"),
        ("empty", r"not a layout that is known; found an empty folder; layouts: NeRF-Synthetic"),
        (
            "other",
            r"found images/, notes.txt; layouts: NeRF-Synthetic \(transforms_train.json\); .*; or demo, demo:NAME",
        ),
        ("parent", r"found scenes inside it \(one\): give one of them"),
        ("nu\0ll", r"the folder cannot be read|no such folder"),
    ],
)
def test_what_is_no_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: str, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("", encoding="utf-8")
    (tmp_path / "empty").mkdir()
    (tmp_path / "other" / "images").mkdir(parents=True)
    (tmp_path / "other" / "notes.txt").write_text("", encoding="utf-8")
    make_scene(tmp_path / "parent" / "one", views=1)
    with pytest.raises(DataError, match=message):
        AutoDatasetConfig().build(data)


def _run(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["sculpt-data", *words])
    try:
        command.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_command_writes_lists_and_inspects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "gaps"
    words = ["demo", "gaps", str(folder), "--views", "3", "--test-views", "1", "--resolution", "24"]
    assert _run(*words, monkeypatch=monkeypatch) == 0
    assert "3 train and 1 test views of 'gaps', 24x24, gt_mesh.ply" in capsys.readouterr().out
    assert len(json.loads((folder / "transforms_train.json").read_text(encoding="utf-8"))["frames"]) == 3
    assert _run("inspect", str(folder), monkeypatch=monkeypatch) == 0
    card = capsys.readouterr().out.splitlines()
    assert card[0] == "scene      gaps"
    assert card[1] == "train      3 views, 24x24, with alpha"
    assert card[2] == "test       1 view, 24x24, with alpha"
    assert card[3].startswith("box        ")
    assert card[4] == f"reference  {folder / 'gt_mesh.ply'}"
    # Three cameras leave half of the sphere unseen, and that is said.
    assert all(line.startswith(("note       ", "look at    ")) for line in card[5:])
    assert any("nothing was photographed from within" in line for line in card)
    assert _run("list", monkeypatch=monkeypatch) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(OBJECTS)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["demo", "gapss", "DIR"], "no demo scene is called 'gapss'"),
        (["demo", "gaps", "."], "exists and is not empty"),
        (["demo", "gaps", "new", "--views", "0"], "--views is 0; expected 1 to 10000"),
        (["inspect", "nowhere"], "nowhere: no such folder"),
    ],
)
def test_command_says_what_is_wrong(
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "something").write_text("", encoding="utf-8")
    assert _run(*words, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert os.listdir(tmp_path) == ["something"]


def test_configs_and_help_need_no_torch() -> None:
    code = (
        "import sys, sculpt_framework.cli.data;"
        "from sculpt_plugins.datasets.auto.config import AutoDatasetConfig;"
        "from sculpt_plugins.datasets.demo.config import DemoConfig;"
        "from sculpt_plugins.datasets.blender.config import BlenderConfig;"
        "sys.exit('torch' in sys.modules or 'numpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
