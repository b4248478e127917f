"""``sculpt-eval`` on meshes, and on runs whose loading another test covers."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from captured import write_ball, write_capture
from photographed_ball import RADIUS

from sculpt_framework.cli.evaluate import evaluate
from sculpt_framework.engine import run as engine_run
from sculpt_framework.errors import ConfigError, DataError
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig


@pytest.fixture
def meshes(tmp_path: Path) -> tuple[str, str]:
    for name, radius in (("mesh", 1.02), ("reference", 1.0)):
        trimesh.creation.icosphere(subdivisions=4, radius=radius).export(tmp_path / f"{name}.ply")
    return str(tmp_path / "mesh.ply"), str(tmp_path / "reference.ply")


def test_json_of_a_mesh_against_a_reference(meshes: tuple[str, str], capsys: pytest.CaptureFixture[str]):
    mesh, reference = meshes
    evaluate(["--mesh", mesh, "--reference", reference, "--json", "--samples", "5000", "--self-intersections"])
    report = json.loads(capsys.readouterr().out)
    assert report["schema"] == 1
    assert report["distances"]["point_to_surface"] == pytest.approx(0.02, rel=0.01)
    assert report["distances"]["samples"] == 5000
    assert report["distances"]["fscore_absolute"] == {"0.002": 0.0, "0.005": 0.0, "0.01": 0.0, "0.02": 1.0}
    assert report["certificate"]["watertight"] is True
    assert report["certificate"]["self_intersections"] == 0
    assert report["triangles"]["under10_pct"] == 0


def test_text_of_a_mesh_alone(meshes: tuple[str, str], capsys: pytest.CaptureFixture[str]):
    evaluate(["--mesh", meshes[0]])
    text = capsys.readouterr().out
    assert "distances are not known" in text
    assert "watertight                        yes" in text
    assert "Chamfer" not in text


def test_a_run_is_rendered_and_measured(
    meshes: tuple[str, str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    finished = SimpleNamespace(
        config=SimpleNamespace(reference=None),
        scene=SimpleNamespace(test=(1, 2), reference_mesh=Path(meshes[1])),
        test_measures=lambda: {"psnr": 30.0, "ssim": 0.9, "iou": None},
    )
    monkeypatch.setattr(engine_run, "load_finished", lambda folder: finished)
    evaluate([str(tmp_path), "--samples", "1000"])
    text = capsys.readouterr().out
    assert "PSNR                              30.00 dB" in text
    assert "Chamfer, point to surface         0.0199" in text
    assert "mask IoU" not in text


def test_a_mesh_against_photographs(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = write_capture(tmp_path / "capture")
    write_ball(tmp_path / "larger.ply", 1.05)
    words = ["--mesh", str(tmp_path / "larger.ply"), "--data", str(folder), "--consistency"]
    evaluate([*words, "--json"])
    found = json.loads(capsys.readouterr().out)["consistency"]
    assert found["pairs"] == 6
    assert found["residual_depth"] == pytest.approx(0.05 * RADIUS, rel=0.25)
    assert 0 < found["residual_px"] < found["residual_p90_px"]
    evaluate(words)
    assert f"  as depth                        {found['residual_depth']:.5g}\n" in capsys.readouterr().out


def test_a_run_against_its_photographs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    scene = AutoDatasetConfig().build(str(write_capture(tmp_path / "capture", truth=False))).load()
    write_ball(tmp_path / "mesh.ply", 1.0)
    finished = SimpleNamespace(
        config=SimpleNamespace(reference=None), scene=scene, test_measures=lambda: {"psnr": None, "ssim": None}
    )
    monkeypatch.setattr(engine_run, "load_finished", lambda folder: finished)
    evaluate([str(tmp_path), "--consistency", "--json"])
    found = json.loads(capsys.readouterr().out)["consistency"]
    assert found["pairs"] == 6
    assert found["residual_depth"] < 0.02 * RADIUS


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        ([], ConfigError, "either a run"),
        (["run", "--mesh", "a"], ConfigError, "either a run"),
        (["--mesh", "a", "--samples", "0"], ConfigError, "--samples is 0"),
        (["--mesh", "a", "--consistency"], ConfigError, "--data DIR"),
        (["--mesh", "a", "--data", "b"], ConfigError, "--consistency needs"),
        (["run", "--data", "b", "--consistency"], ConfigError, "--consistency needs"),
        (["--mesh", "nowhere.ply"], DataError, "no mesh file at nowhere.ply"),
    ],
)
def test_mistakes_are_explained(words: list[str], error: type[Exception], message: str):
    with pytest.raises(error, match=message):
        evaluate(words)


def test_a_flat_reference_is_explained(meshes: tuple[str, str], tmp_path: Path):
    needle = trimesh.Trimesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [[0, 1, 2]], process=False)
    needle.export(tmp_path / "needle.ply")
    with pytest.raises(DataError, match="area 0"):
        evaluate(["--mesh", meshes[0], "--reference", str(tmp_path / "needle.ply")])
