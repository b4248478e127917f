"""``sculpt-export``: simplified, textured, with attributes, turning, as maps; from a run whose mesh is a ball."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from small_scene import color_at, views_of_ball, write_run

from sculpt_framework.cli.export import export
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.export.ply import read_vertex_rows


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    scene = folder / "scene"
    (scene / "train").mkdir(parents=True)
    frames = []
    for view in views_of_ball(8, 64, only_above=True):
        assert view.alpha is not None
        pixels = np.dstack([view.rgb.numpy()[..., ::-1], view.alpha.numpy()])
        assert cv2.imwrite(str(scene / "train" / f"{view.name}.png"), np.rint(pixels * 255).astype(np.uint8))
        matrix = np.linalg.inv(view.camera.world_to_camera.numpy()) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"train/{view.name}", "transform_matrix": matrix.tolist()})
    camera = view.camera
    document = {"fl_x": camera.fx, "frames": frames}
    (scene / "transforms_train.json").write_text(json.dumps(document), encoding="utf-8")
    write_run(folder / "run", scene)
    return folder / "run"


def _export(*words: object) -> None:
    export([str(word) for word in words])


@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
def test_fewer_faces(kind: str, run_dir: Path, tmp_path: Path):
    out = tmp_path / f"a.{kind}"
    _export(run_dir, "--format", kind, "--target-faces", 600, "--out", out)
    mesh = next(iter(trimesh.load_scene(out, process=False).geometry.values()))
    faces = np.array(mesh.faces, np.int64)
    assert 590 <= len(faces) <= 600
    assert certify(np.array(mesh.vertices, np.float64), faces).outward


def test_fewer_faces_beside_the_whole_mesh(run_dir: Path, capsys: pytest.CaptureFixture[str]):
    before = (run_dir / "mesh.ply").read_bytes()
    _export(run_dir, "--format", "ply", "--target-faces", 100)
    assert capsys.readouterr().out.startswith(f"{run_dir / 'mesh-100.ply'}\n")
    assert (run_dir / "mesh.ply").read_bytes() == before


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_textured(kind: str, run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("xatlas")
    out = tmp_path / f"a.{kind}"
    # As it stands in the scene, to compare places with what is there.
    words = ("--texture", "--texture-size", 128, "--target-faces", 800, "--up", "Y")
    _export(run_dir, "--format", kind, *words, "--out", out)
    lines = capsys.readouterr().out.splitlines()
    assert lines[:-2] == [str(tmp_path / f"a.{end}") for end in ([kind] if kind == "glb" else ["obj", "mtl", "png"])]
    assert "% of it is in no photograph and has the mesh's colours" in lines[-1]
    mesh = next(iter(trimesh.load_scene(out, process=False).geometry.values()))
    assert mesh.visual.kind == "texture"
    # Seen or not, the ball has its colours all over: the mesh's were those.
    colors = np.asarray(mesh.visual.to_color().vertex_colors)[:, :3] / 255
    places = np.asarray(mesh.vertices)
    error = np.abs(colors - color_at(places * 0.8 / np.linalg.norm(places, axis=1, keepdims=True)))
    assert np.median(error) < 0.03


def test_attributes(run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "a.ply"
    _export(run_dir, "--format", "ply", "--attributes", "--out", out)
    rows = read_vertex_rows(out)
    assert rows.dtype.names == (
        *("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"),
        *("times_seen", "best_view_angle"),
    )
    unseen = rows["times_seen"] == 0
    assert f"{unseen.sum()} of {len(rows)} vertices are in no photograph" in capsys.readouterr().out
    # All cameras are above.
    assert unseen[rows["z"] < -0.7].all()
    assert not unseen[rows["z"] > 0.5].any()
    assert (rows["best_view_angle"][unseen] == 90).all()
    assert rows["best_view_angle"][rows["z"] > 0.5].max() < 60
    again = trimesh.load(out, process=False)
    assert "times_seen" in again.metadata["_ply_raw"]["vertex"]["data"].dtype.names
    np.testing.assert_allclose(np.linalg.norm([rows["nx"], rows["ny"], rows["nz"]], axis=0), 1, atol=1e-5)


def test_turntable_and_maps(run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "turn.gif"
    _export(run_dir, "--format", "turntable", "--frames", 3, "--size", 48, "--out", out)
    assert out.read_bytes().startswith(b"GIF89a")
    _export(run_dir, "--format", "maps", "--out", tmp_path / "maps")
    assert "for 8 train views" in capsys.readouterr().out
    assert len(list((tmp_path / "maps" / "depth").iterdir())) == 8
    with pytest.raises(ConfigError, match=r"the run has no test views"):
        _export(run_dir, "--format", "maps", "--cameras", "test")


def test_photographs_that_moved(run_dir: Path, tmp_path: Path):
    config = json.loads((run_dir / "config.json").read_text(encoding="utf-8"))
    elsewhere = tmp_path / "run"
    elsewhere.mkdir()
    (elsewhere / "mesh.ply").write_bytes((run_dir / "mesh.ply").read_bytes())
    data = config["data"]
    (elsewhere / "config.json").write_text(json.dumps(config | {"data": str(tmp_path / "gone")}), encoding="utf-8")
    with pytest.raises(DataError, match=r"gone: no such folder.*--data DIR says where it is now"):
        _export(elsewhere, "--format", "ply", "--attributes")
    assert sorted(path.name for path in elsewhere.iterdir()) == ["config.json", "mesh.ply"]
    _export(elsewhere, "--format", "ply", "--attributes", "--data", data)
    assert (elsewhere / "mesh-attributes.ply").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--format", "ply", "--texture"], r"--texture goes with --format obj, glb or turntable, not ply"),
        (["--format", "glb", "--attributes"], r"--attributes goes with --format ply, not glb"),
        (
            ["--format", "gaussians", "--target-faces", 5],
            r"--target-faces goes with --format ply, obj, .* or maps, not gaussians",
        ),
        (["--format", "turntable", "--frames", 0], r"--frames is 0; expected 1 to 3600"),
        (["--format", "turntable", "--size", 1], r"--size is 1; expected 16 to 4096"),
        (["--format", "obj", "--target-faces", 2], r"--target-faces is 2; expected 4 or more"),
    ],
)
def test_options_that_do_not_go_together(words: list, message: str, run_dir: Path):
    before = sorted(run_dir.iterdir())
    with pytest.raises(ConfigError, match=message):
        _export(run_dir, *words)
    assert sorted(run_dir.iterdir()) == before
