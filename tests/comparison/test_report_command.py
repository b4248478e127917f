"""``sculpt-report`` as its user runs it: on runs and on meshes made elsewhere."""

import csv
import re
import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from written_runs import row, write_run

from sculpt_framework.cli.report import report
from sculpt_framework.errors import ConfigError, DataError, SculptError

FILES = [
    "error_over_time.png",
    "error_over_time.svg",
    "overall.csv",
    "report.html",
    "results.csv",
    "runs.csv",
    "tables.md",
    "tables.tex",
    "time_to_error.png",
    "time_to_error.svg",
]


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    folder = tmp_path / "runs"
    for kind, factor in (("hash-grid", 1.0), ("mlp", 2.0)):
        for seed in range(3):
            rows = [row(t, factor * (1 + 0.1 * seed) * 0.04 / t**0.5, psnr=20.0) for t in (1.0, 4.0, 16.0)]
            write_run(folder / kind / str(seed), rows, config={"seed": seed, "field": {"type": kind}})
    write_run(folder / "mlp" / "3", [row(1.0, 0.1)], status=None, config={"seed": 3, "field": {"type": "mlp"}})
    return folder


def written(folder: Path, name: str) -> list[dict[str, str]]:
    with open(folder / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_folder_of_runs(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out" / "deep"
    report([str(runs), "--out", str(out), "--title", "A <test>"])
    assert sorted(path.name for path in out.iterdir()) == FILES
    first, second = written(out, "results.csv")
    assert (first["scene"], first["method"], first["runs"], first["failures"]) == ("jar", "hash-grid", "3", "0")
    assert float(first["median"]) == pytest.approx(1.1 * 0.01)
    assert (second["method"], second["runs"], second["failures"]) == ("mlp", "4", "1")
    # Four seeds, one failed: between the second and the third best.
    assert float(second["median"]) == pytest.approx(2 * 0.01 * 1.15)
    target = float(second["target"])
    assert target == pytest.approx(2 * 0.01 * 1.2)
    # Hash grids have error 0.04 f / sqrt(t): the middle one reaches it at (0.04 f / target)^2.
    assert float(first["seconds_to_target"]) == pytest.approx((1.1 * 0.04 / target) ** 2, rel=1e-6)
    assert [line["wins"] for line in written(out, "overall.csv")] == ["1", "0"]
    assert len(written(out, "runs.csv")) == 7
    told = capsys.readouterr().out
    assert "1 of 7 have no result: 3 (mlp, jar): not ended; last measured after 1 s" in told
    assert str(out / "report.html") in told


def test_the_page_is_complete_in_itself(runs: Path, tmp_path: Path):
    report([str(runs), "--out", str(tmp_path / "out"), "--title", "A <test>"])
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<h1>A &lt;test&gt;</h1>" in page
    assert not re.findall(r"<(script|link|iframe|object)", page)
    assert not [url for url in re.findall(r'(?:src|href)="([^"]+)"', page) if not url.startswith("data:")]
    assert page.count("<svg") == 2
    for text in ("infinitely bad", "training time, s (log)", "Chamfer distance, scene units (log)", "hash-grid"):
        assert text in page


def test_the_diagrams_are_pictures(runs: Path, tmp_path: Path):
    report([str(runs), "--out", str(tmp_path)])
    for name in ("error_over_time", "time_to_error"):
        root = ElementTree.fromstring((tmp_path / f"{name}.svg").read_text(encoding="utf-8"))
        width, height = (float(number) for number in root.attrib["viewBox"].split()[2:])
        data = (tmp_path / f"{name}.png").read_bytes()
        assert struct.unpack(">II", data[16:24]) == (round(2 * width), round(2 * height))


def test_meshes_made_elsewhere_join(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Spheres around a unit sphere are at Chamfer distance of their gap."""
    scene = tmp_path / "scene"
    scene.mkdir()
    for name, radius in (("scene/gt_mesh", 1.0), ("near", 1.02), ("far", 1.1)):
        trimesh.creation.icosphere(subdivisions=4, radius=radius).export(tmp_path / f"{name}.ply")
    run = write_run(tmp_path / "run", [row(1.0, 0.2), row(4.0, 0.05)], config={"data": str(scene)})
    words = [str(run), "--mesh", f"near={tmp_path / 'near.ply'}:7.5", "--mesh", f"far@jar={tmp_path / 'far.ply'}"]
    report([*words, "--samples", "5000", "--out", str(tmp_path / "out")])
    rows = {line["method"]: line for line in written(tmp_path / "out", "results.csv")}
    assert float(rows["near"]["median"]) == pytest.approx(0.02, rel=0.02)
    assert float(rows["far"]["median"]) == pytest.approx(0.1, rel=0.02)
    assert (rows["near"]["seconds"], rows["far"]["seconds"]) == ("7.5", "")
    assert (rows["sculpting"]["median"], rows["sculpting"]["seconds"]) == ("0.05", "4.0")
    assert "times of external meshes" in capsys.readouterr().out


def test_meshes_alone_need_a_reference(tmp_path: Path):
    sphere, flat = tmp_path / "ball.ply", tmp_path / "flat.ply"
    trimesh.creation.icosphere(subdivisions=2).export(sphere)
    trimesh.Trimesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [[0, 1, 2]], process=False).export(flat)
    words = ["--mesh", f"m={sphere}", "--mesh", f"f={flat}", "--samples", "500"]
    report([*words, "--reference", str(sphere), "--out", str(tmp_path / "out")])
    rows = written(tmp_path / "out", "results.csv")
    assert [(line["scene"], line["failures"]) for line in rows] == [("ball", "0"), ("ball", "1")]
    with pytest.raises(DataError, match="area 0"):
        report([*words, "--reference", str(flat), "--out", str(tmp_path / "other")])


def test_without_a_reference_psnr_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_run(tmp_path / "a", [row(1.0, None, psnr=20.0), row(4.0, None, psnr=30.0)])
    report([str(tmp_path / "a"), "--out", str(tmp_path / "out")])
    assert "median PSNR on held-out views, dB" in capsys.readouterr().out
    with pytest.raises(DataError, match=r"no run knows its Chamfer distance"):
        report([str(tmp_path / "a"), "--out", str(tmp_path / "out"), "--measure", "chamfer"])


def test_what_cannot_be_compared_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for name, digest in (("a", "12"), ("b", "34")):
        threads = {"threads": int(digest)}
        write_run(tmp_path / name, [row(1.0, 0.1)], inputs={"cameras": digest, "x": "1"}, config=threads)
    report([str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "out")])
    told = capsys.readouterr().out
    assert "runs of jar did not read the same: cameras differ" in told
    assert "different thread counts: 12, 34" in told


def test_another_target_and_clock(runs: Path, tmp_path: Path):
    report([str(runs / "hash-grid"), "--out", str(tmp_path), "--target", "0.022", "--clock", "wall"])
    (line,) = written(tmp_path, "results.csv")
    assert float(line["seconds_to_target"]) == pytest.approx(2 * (1.1 * 0.04 / 0.022) ** 2)
    assert float(line["seconds"]) == 32


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        ("", ConfigError, "nothing to compare"),
        ("nowhere", DataError, "no such folder"),
        ("--mesh near.ply", ConfigError, "expected NAME=FILE"),
        ("--mesh a@=near.ply", ConfigError, "expected NAME=FILE"),
        ("--mesh a=near.ply", ConfigError, "neither a run nor a --reference"),
        ("--mesh a@jar=near.ply", ConfigError, "no reference mesh is known for jar"),
        ("--mesh a=near.ply --reference b=x --reference c=y", ConfigError, "of which scene"),
        ("--mesh a=near.ply --reference x.ply --reference y.ply", ConfigError, "give each once"),
        ("--mesh a=near.ply --reference x.ply", DataError, "no mesh file at x.ply"),
        ("runs --samples 0", ConfigError, "--samples is 0"),
        ("runs --target nan", ConfigError, "--target is nan"),
    ],
)
def test_mistakes_are_explained(
    words: str, error: type[SculptError], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        report([*words.split(), "--out", "out"])
    assert not (tmp_path / "out").exists()


def test_an_output_that_cannot_be_written(runs: Path, tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(SculptError, match="cannot write"):
        report([str(runs), "--out", str(tmp_path / "file" / "out")])
