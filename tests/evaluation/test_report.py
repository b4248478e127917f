"""The report: one page, complete in itself, whatever of the run is there."""

import itertools
import json
from dataclasses import asdict
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.curve import header_line, row_line
from sculpt_framework.evaluation.pictures import (
    DIFFERENCE_SCALE,
    color_picture,
    difference_picture,
    error_colors,
    normal_picture,
    png_data_uri,
)
from sculpt_framework.evaluation.report import seconds_spent, write_report
from sculpt_framework.export.mesh_files import write_mesh_ply


class Page(HTMLParser):
    """Tags with their attributes, and the text."""

    def __init__(self, path: Path):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data + "\n"


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    shape = trimesh.creation.torus(1, 0.3)
    vertices, faces = np.array(shape.vertices, float), np.array(shape.faces, np.int64)
    write_mesh_ply(tmp_path / "mesh.ply", vertices, faces)
    rows = [{"t_train_s": t, "chamfer_ps": 0.01 / t, "psnr": 20 + t, "iou": 0.9, "faces": 100} for t in (1, 2, 4)]
    (tmp_path / "curve.csv").write_text(header_line() + "".join(map(row_line, rows)), encoding="utf-8")
    metrics = {
        "status": "finished",
        "scene": "jar <1>",
        "method": "sculpting",
        "seed": 3,
        "final": {**rows[-1], "ssim": None},
        "milestones": [
            {"share": 0.25, "chamfer_ps": 0.0123, "psnr": 21.0, "iou": None},
            {"share": 0.5, "chamfer_ps": 0.0122, "psnr": 22.0, "iou": 0.9},
        ],
        "certificate": asdict(certify(vertices, faces)),
        "versions": {"torch": "2.13", "numba": None},
    }
    (tmp_path / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    (tmp_path / "config.json").write_text(json.dumps({"field": {"type": "hash-grid"}}), encoding="utf-8")
    about = {"scene": "jar", "device": "cpu", "notes": ["grey images"], "inputs": {"train images": "ab12"}}
    events = [
        {"t_train": 0.0, "t_wall": 3.0, "event": "run_started", "data": about},
        {"t_train": 1.0, "t_wall": 4.0, "event": "decision", "data": {"item": "initial surface", "value": "hull"}},
        {"t_train": 4.0, "t_wall": 9.0, "event": "evaluation", "data": {}},
        {"t_train": 4.0, "t_wall": 9.5, "event": "checkpoint", "data": {}},
        {"t_train": 6.0, "t_wall": 12.0, "event": "stage", "data": {}},
    ]
    (tmp_path / "events.jsonl").write_text("\n".join(map(json.dumps, events)) + '\n{"event": "out', encoding="utf-8")
    return tmp_path


def test_everything_is_in_the_page(run_dir: Path):
    black, white = np.zeros((4, 6, 3), np.uint8), np.full((4, 6, 3), 255, np.uint8)
    pictures = {"Result": {"reference": black, "render": white}, "Before training": {"render": black}}
    page = Page(write_report(run_dir, pictures))
    for fact in (
        "jar <1> · sculpting",
        "0.0025",
        "24.00 dB",
        "0.0123",
        "grey images",
        "hull",
        "hash-grid",
        "2.13",
        "ab12",
    ):
        assert fact in page.text
    for label in ("training time, s (logarithmic)", "dB", "scene units (log)", "degrees", "genus", "watertight"):
        assert label in page.text
    assert [attributes["alt"] for tag, attributes in page.tags if tag == "img"] == ["reference", "render", "render"]
    assert "Not recorded" not in page.text
    assert "There is no reference" not in page.text


def test_it_says_where_the_time_went(run_dir: Path):
    lines = Page(write_report(run_dir, {})).text.splitlines()
    facts = dict(itertools.pairwise(lines))
    assert facts["start and loading"] == "3.0 s, 25 %"
    assert facts["training"] == "6.0 s, 50 %"
    assert facts["measuring"] == "2.0 s, 17 %"
    assert facts["saving checkpoints"] == "0.5 s, 4 %"
    assert facts["compiling, pictures, viewing, writing"] == "0.5 s, 4 %"


def test_what_passed_before_a_measurement_is_not_measuring():
    events = [
        {"t_train": 0.0, "t_wall": 1.0, "event": "run_started", "data": {}},
        {"t_train": 2.0, "t_wall": 8.0, "event": "evaluation", "data": {"seconds": 1.5}},
    ]
    spent = seconds_spent(events)
    assert spent["measuring"] == 1.5
    assert spent["compiling, pictures, viewing, writing"] == 3.5
    assert sum(spent.values()) == 8.0


def test_of_a_resumed_run_it_is_the_last_process(run_dir: Path):
    again = {"t_train": 6.0, "t_wall": 2.0, "event": "run_started", "data": {"scene": "jar"}}
    more = {"t_train": 8.0, "t_wall": 4.0, "event": "stage", "data": {}}
    with open(run_dir / "events.jsonl", "a", encoding="utf-8") as events:
        events.write(f"\n{json.dumps(again)}\n{json.dumps(more)}\n")
    lines = Page(write_report(run_dir, {})).text.splitlines()
    facts = dict(itertools.pairwise(lines))
    assert (facts["start and loading"], facts["training"]) == ("2.0 s, 50 %", "2.0 s, 50 %")


def test_the_plan_is_shown_where_there_is_one(run_dir: Path):
    assert "Plan" not in Page(write_report(run_dir, {})).text
    decision = {"item": "octree", "value": False, "evidence": "thin < 1 px", "saves": "2 s", "override": "--octree"}
    (run_dir / "plan.json").write_text(
        json.dumps({"decisions": [decision, {"item": "masks", "value": "alpha"}]}), encoding="utf-8"
    )
    text = Page(write_report(run_dir, {})).text
    for word in ("Plan", "evidence", "thin < 1 px", "--octree", "masks", "alpha"):
        assert word in text
    assert text.splitlines().count("not measured") == 2, "seconds and megabytes that the octree would have taken"
    (run_dir / "plan.json").write_text("[", encoding="utf-8")
    with pytest.raises(DataError, match=r"plan\.json is not valid JSON"):
        write_report(run_dir, {})


def test_no_cell_of_the_shares_of_a_run_is_blank(run_dir: Path):
    text = write_report(run_dir, {}).read_text(encoding="utf-8")
    assert "<td>25 %</td><td>0.0123</td><td>21</td><td>not known</td>" in text
    assert "<td>50 %</td><td>0.0122</td><td>22</td><td>0.9</td>" in text


def test_nothing_is_loaded_from_elsewhere(run_dir: Path):
    page = Page(write_report(run_dir, {"Result": {"render": np.zeros((2, 2, 3), np.uint8)}}))
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object"}
    sources = [attributes.get("src") or attributes.get("href") or "" for _, attributes in page.tags]
    assert all(source == "" or source.startswith("data:") for source in sources)


def test_a_run_without_reference_says_what_is_not_known(run_dir: Path):
    (run_dir / "curve.csv").write_text(header_line() + row_line({"t_train_s": 1.0, "psnr": 20.0}), encoding="utf-8")
    metrics = json.loads((run_dir / "metrics.json").read_text(encoding="utf-8"))
    metrics["final"]["chamfer_ps"] = None
    (run_dir / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    page = write_report(run_dir, {})
    text = Page(page).text
    charts = page.read_text(encoding="utf-8").partition('<div class="charts">')[2].partition("</div>")[0]
    assert charts.count("<svg") == 1, "a chart of PSNR, and no empty place beside it"
    assert 'class="unknown"' not in charts
    (missing,) = (line for line in text.splitlines() if line.startswith("Not known for this run: "))
    for name in ("Chamfer distance to the reference", "Displacement between neighbouring views", "Peak memory"):
        assert name in missing
    assert "PSNR" not in missing
    assert "There is no reference mesh: how far the surface is from the true one is not known" in text


def test_an_empty_run_directory_gives_a_page_too(tmp_path: Path):
    text = Page(write_report(tmp_path, {})).text
    assert text.count("Not recorded") >= 5


def test_broken_files_are_named(run_dir: Path):
    (run_dir / "metrics.json").write_text("{", encoding="utf-8")
    with pytest.raises(DataError, match=r"metrics\.json is not valid JSON"):
        write_report(run_dir, {})


def test_pictures():
    colors = color_picture(np.array([[[0.0, 0.5, 2.0]]]))
    np.testing.assert_array_equal(colors, [[[0, 128, 255]]])
    same = np.full((1, 1, 3), 0.3)
    np.testing.assert_array_equal(difference_picture(same, same), [[[255, 255, 255]]])
    np.testing.assert_array_equal(difference_picture(same, same + DIFFERENCE_SCALE), [[[60, 10, 0]]])
    normals = normal_picture(np.array([[[0.0, 0, 1], [0, 0, 0], [-3, 0, 0]]]))
    np.testing.assert_array_equal(normals, [[[128, 128, 255], [255, 255, 255], [0, 128, 128]]])
    errors = error_colors(np.array([0.0, 0.5, 1.0, 7.0]))
    assert errors.min() >= 0
    assert (np.diff(errors.sum(axis=1)) <= 0).all(), "more error is darker"
    np.testing.assert_array_equal(errors[2], errors[3])


def test_png_keeps_every_pixel():
    import base64

    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    uri = png_data_uri(picture)
    encoded = np.frombuffer(base64.b64decode(uri.removeprefix("data:image/png;base64,")), np.uint8)
    np.testing.assert_array_equal(cv2.imdecode(encoded, cv2.IMREAD_COLOR)[:, :, ::-1], picture)
