"""``sculpt-bench suite captures``: what sculpt-train would leave is laid beside photographs, truth and other meshes."""

import csv
import json
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from captured import write_ball, write_capture
from photographed_ball import RADIUS

from sculpt_framework.cli.bench import bench
from sculpt_framework.cli.evaluate import evaluate
from sculpt_framework.errors import ConfigError, DataError, TrainingFailed
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.experiments.capture_measures import Capture
from sculpt_framework.experiments.matrix import Setting, cross, remember
from sculpt_framework.experiments.runner import TRAIN
from sculpt_framework.experiments.suites import find_suite

FAKE = (sys.executable, "-S", str(Path(__file__).parents[1] / "experiments" / "fake_train.py"))
OUT = Path("outputs/suite-captures")


@pytest.fixture
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A ball with masks, truth and another program's mesh, one with none of these, one that is refused, one folder
    of photographs without cameras."""
    monkeypatch.setattr("sculpt_framework.experiments.runner.TRAIN", FAKE)
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "captures"
    write_ball(write_capture(folder / "ball") / "openmvs.ply", 1.04)
    write_capture(folder / "bare", masks=False, truth=False)
    write_capture(folder / "refused")
    (folder / "refused" / "refused").touch()
    (folder / "looks").mkdir()
    for name in "abcd":
        cv2.imwrite(str(folder / "looks" / f"{name}.png"), np.zeros((8, 8, 3), np.uint8))
    for name in ("ball", "bare"):
        write_ball(folder / name / "result.ply", 1.02)
    return folder


def rows(place: Path = OUT) -> list[dict[str, str]]:
    with open(place / "results.csv", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def started() -> int:
    return len((OUT / "started.txt").read_text(encoding="utf-8").splitlines())


def test_which_captures_there_are(captures: Path):
    def labels(*arguments: object) -> list[str]:
        return [scene.label for scene in find_suite("captures", captures, *arguments).scenes]  # pyright: ignore

    assert labels([], None) == ["ball", "bare", "refused"]
    assert labels(["bare"], None) == ["bare"]
    assert labels([], None, "without") == ["ball-without-masks", "bare", "refused-without-masks"]
    assert labels(["ball", "bare"], None, "both") == ["ball", "ball-without-masks", "bare"]
    suite = find_suite("captures", captures, ["ball"], None, "both")
    assert [scene.words for scene in suite.scenes] == [(), ("--dataset.masks", "ignored")]
    assert suite.left_out == ("looks",)


@pytest.mark.slow
def test_from_words_to_table_and_page(captures: Path, capsys: pytest.CaptureFixture[str]):
    words = ["suite", "captures", "captures", "--masks", "both", "--against", "openmvs.ply", "--max-time", "9"]
    bench(words)
    said = capsys.readouterr().out
    found = {(row["capture"], row["mesh"]): row for row in rows()}
    assert list(found) == [
        ("ball", "gaussian-sculpting"),
        ("ball-without-masks", "gaussian-sculpting"),
        ("ball", "openmvs"),
        ("bare", "gaussian-sculpting"),
        ("refused", "gaussian-sculpting"),
        ("refused-without-masks", "gaussian-sculpting"),
    ]
    ours, other = found["ball", "gaussian-sculpting"], found["ball", "openmvs"]
    for row, share in ((ours, 0.02), (other, 0.04)):
        assert float(row["radius"]) == pytest.approx(RADIUS, rel=1e-3)
        assert float(row["distance"]) == pytest.approx(share * RADIUS, rel=0.05)
        assert float(row["residual_depth"]) == pytest.approx(share * RADIUS, rel=0.3)
        assert row["watertight"] == "1"
    assert (ours["psnr"], ours["t_wall_s"]) == ("30", "4")
    assert (other["psnr"], other["t_wall_s"], other["rss_mb"]) == ("", "", "")
    # The same mesh is measured by the same photographs, whatever the run made of the masks.
    unmasked = found["ball-without-masks", "gaussian-sculpting"]
    assert [unmasked[name] for name in ("distance", "residual_px")] == [ours[n] for n in ("distance", "residual_px")]
    assert found["bare", "gaussian-sculpting"]["distance"] == ""
    assert float(found["bare", "gaussian-sculpting"]["residual_px"]) > 0
    refused = found["refused", "gaussian-sculpting"]
    assert (refused["status"], refused["error"]) == ("failed", "the data are no good")

    page = (OUT / "tables.md").read_text(encoding="utf-8")
    assert re.search(r"\| ball \| openmvs \| [34]\.\d+ \|.* – \| – \| – \| – \| yes \| – \|", page)
    assert "| 1; 1 failed; the data are no good |" in page
    assert "without masks in files, taken as they are: bare." in page
    assert "folders that are no captures: looks." in page
    assert "Residual between photographs" not in (OUT / "report.html").read_text(encoding="utf-8"), (
        "the fake keeps no residual"
    )
    assert "<svg" in (OUT / "report.html").read_text(encoding="utf-8")
    assert "measuring 3 meshes of ball" in said
    assert started() == 5 + 1, "runs, and a warm-up by which kernels are compiled"

    bench(words)
    assert "measuring" not in capsys.readouterr().out
    assert started() == 6
    write_ball(captures / "ball" / "openmvs.ply", 1.08)
    bench(words)
    assert "measuring 1 meshes of ball" in capsys.readouterr().out
    changed = next(row for row in rows() if row["mesh"] == "openmvs")
    assert float(changed["distance"]) == pytest.approx(0.08 * RADIUS, rel=0.05)


@pytest.mark.slow
def test_a_mesh_or_capture_that_cannot_be_measured_is_a_row_that_says_why(captures: Path):
    (captures / "ball" / "openmvs.ply").write_text("no mesh", encoding="utf-8")
    (captures / "bare" / "images" / "3.png").write_bytes(b"no image")
    bench(["suite", "captures", "captures", "--objects", "ball", "bare", "--against", "openmvs.ply"])
    errors = {(row["capture"], row["mesh"]): row["error"] for row in rows()}
    assert errors["ball", "gaussian-sculpting"] == ""
    assert "openmvs.ply" in errors["ball", "openmvs"]
    assert "3.png" in errors["bare", "gaussian-sculpting"]


def test_show_measures_nothing(captures: Path, capsys: pytest.CaptureFixture[str]):
    OUT.mkdir(parents=True)
    setting = Setting(name="gaussian-sculpting", method="gaussian-sculpting")
    scenes = find_suite("captures", captures, [], None).scenes
    remember(cross("Suite captures", [setting], scenes, [None], [0], []), OUT)
    (captures / "ball" / "openmvs.obj").write_bytes((captures / "ball" / "openmvs.ply").read_bytes())
    bench(["suite", "captures", "captures", "--against", "openmvs.ply", "--show"])
    assert "measuring" not in capsys.readouterr().out
    assert [(row["mesh"], row["error"]) for row in rows()] == [("openmvs", "not measured: not measured yet")]
    # Two files that differ in their endings alone are two meshes.
    bench(["suite", "captures", "captures", "--against", "openmvs.ply", "openmvs.obj", "--show"])
    assert [row["mesh"] for row in rows()] == ["openmvs.ply", "openmvs.obj"]


def test_when_all_runs_fail_the_command_does(captures: Path):
    with pytest.raises(TrainingFailed, match="the data are no good"):
        bench(["suite", "captures", "captures", "--objects", "refused"])
    assert [row["status"] for row in rows()] == ["failed"]


def test_what_has_no_truth_and_no_area(captures: Path):
    bare = Capture(str(captures / "bare"))
    measured = bare.measure(load_mesh(captures / "bare" / "result.ply"))
    assert "distance" not in measured
    assert json.loads(json.dumps(measured)) == measured
    (captures / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", encoding="utf-8")
    with pytest.raises(DataError, match="no area"):
        bare.measure(load_mesh(captures / "flat.obj"))


@pytest.mark.slow
def test_with_real_runs(captures: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sculpt_framework.experiments.runner.TRAIN", TRAIN)
    folder = captures.parent / "around"
    write_ball(write_capture(folder / "ball", views=30) / "openmvs.ply", 1.04)
    write_capture(folder / "bare", masks=False, truth=False, views=30)
    words = "suite captures around --against openmvs.ply --steps 4"
    extra = "--methods gaussian-sculpting-tiny -- --trainer.fit-steps 30 --trainer.polish-steps 4"
    bench([*words.split(), *extra.split()])
    found = rows()
    assert [row["status"] for row in found] == ["finished"] * 3
    assert all(float(row["residual_px"]) > 0 for row in found)
    assert all(float(row["t_wall_s"]) > 0 for row in found if row["mesh"] != "openmvs")
    page = (OUT / "report.html").read_text(encoding="utf-8")
    assert "Distance to the truth against time" in page
    assert "Residual between photographs against time" in page
    # The same figures as the command for one run.
    capsys.readouterr()
    (run,) = OUT.glob("runs/ball/*/*/seed-0")
    evaluate([str(run), "--consistency", "--json"])
    told = json.loads(capsys.readouterr().out)["consistency"]
    assert told["residual_px"] == pytest.approx(float(found[0]["residual_px"]), rel=1e-4)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("captures", "needs the folder"),
        ("captures captures/looks", "holds no captures"),
        ("captures captures --objects nothing", "no such capture; there are ball, bare, refused"),
        ("captures captures --references captures", "gt_mesh.ply in each capture's folder"),
        ("captures captures --against nothing.ply", "no capture has a file of that name"),
        ("captures captures --against a/b.ply", "expected a file's name"),
        ("demo --masks both", "for the suite captures"),
    ],
)
def test_mistakes(words: str, message: str, captures: Path):
    with pytest.raises(ConfigError, match=re.escape(message)):
        bench(["suite", *words.split()])
