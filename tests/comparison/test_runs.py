"""Run directories read back: finished, failed, killed, damaged; and the time to reach an error."""

import json
import math
from pathlib import Path

import pytest
from written_runs import CONFIG, record, row, write_run

from sculpt_framework.comparison.runs import CurvePoint, load_run, time_to_reach
from sculpt_framework.errors import DataError

ROWS = [row(1.0, 0.04, psnr=20.0, outer=2.0), row(4.0, 0.02, psnr=22.0, outer=5.0), row(16.0, 0.01, psnr=24.0)]
STAGES = [
    {"event": "stage", "t_train": 0.5, "t_wall": 1.0, "data": {"index": 0}},
    {"event": "stage", "t_train": 4.0, "t_wall": 5.0, "data": {"index": 1}},
]


def test_a_finished_run(tmp_path: Path):
    folder = write_run(tmp_path / "a", ROWS, events=STAGES, final={"chamfer_ps": 0.0099}, inputs={"cameras": "12ab"})
    run = load_run(folder)
    assert (run.name, run.scene, run.method, run.seed, run.device) == ("a", "jar", "sculpting", 0, "cpu")
    assert (run.failed, run.reason) == (False, None)
    assert [point.train_seconds for point in run.curve] == [1, 4, 16]
    assert [point.stage for point in run.curve] == [0, 1, 1]
    assert (run.curve[0].wall_seconds, run.curve[0].cpu_seconds, run.curve[0].step) == (2, 3, 2)
    assert run.result("chamfer") == 0.0099
    assert run.result("psnr") == 24
    assert run.result("iou") is None
    assert (run.total_seconds("train"), run.total_seconds("cpu")) == (16, 48)
    assert run.versions == {"torch": "2.13"}
    assert run.inputs == {"cameras": "12ab"}
    assert run.config["field"] == CONFIG["field"]


def test_the_curve_ends_with_the_result_which_has_more_samples(tmp_path: Path):
    run = load_run(write_run(tmp_path / "a", ROWS, final={"chamfer_ps": 0.0099}))
    assert [point.chamfer for point in run.curve] == [0.04, 0.02, 0.0099]
    assert time_to_reach(run.curve, 0.0099) == 16
    other = load_run(write_run(tmp_path / "b", ROWS, final={"chamfer_ps": 0.5, "t_train_s": 30.0}))
    assert other.curve[-1].chamfer == 0.01, "of another state than the last row's"


def test_the_clocks_of_a_resumed_run_go_on(tmp_path: Path):
    again = [
        {**row(32.0, 0.005), "t_wall_s": 5.0, "t_cpu_s": 7.0},
        {**row(40.0, 0.004), "t_wall_s": 9.0, "t_cpu_s": 8.0},
    ]
    run = load_run(write_run(tmp_path / "a", [*ROWS, *again]))
    assert [point.wall_seconds for point in run.curve] == [2, 8, 32, 37, 41]
    assert [point.cpu_seconds for point in run.curve] == [3, 12, 48, 55, 56]
    assert (run.total_seconds("wall"), run.total_seconds("train")) == (41, 40)


def test_a_killed_run_has_a_curve_and_is_a_failure(tmp_path: Path):
    folder = write_run(tmp_path / "a", ROWS, status=None, events=STAGES)
    with (
        open(folder / "curve.csv", "a", encoding="ascii") as curve,
        open(folder / "events.jsonl", "a", encoding="utf-8") as events,
    ):
        curve.write("20.0,4")
        events.write('{"event": "outer_st')
    run = load_run(folder)
    assert run.failed
    assert run.reason == "not ended; last measured after 16 s"
    assert run.result("chamfer") == math.inf
    assert run.result("psnr") == -math.inf
    assert (run.scene, len(run.curve), run.total_seconds("train")) == ("jar", 3, 16)


def test_a_run_that_has_only_begun(tmp_path: Path):
    (tmp_path / "config.json").write_text(json.dumps(CONFIG), encoding="utf-8")
    run = load_run(tmp_path)
    assert (run.scene, run.curve, run.total_seconds("train")) == ("jar", (), None)
    assert run.reason == "not ended, and nothing was measured"


def test_a_failed_run_says_why(tmp_path: Path):
    ended = {"event": "run_ended", "t_train": 4.0, "t_wall": 8.0, "data": {"failure": "loss is not finite"}}
    run = load_run(write_run(tmp_path / "a", ROWS[:2], status="failed", events=[ended]))
    assert (run.failed, run.reason) == (True, "loss is not finite")
    assert run.result("chamfer") == math.inf, "the mesh it saved is no result"
    assert load_run(write_run(tmp_path / "b", ROWS, status="stopped")).reason == "stopped before its end"
    flat = load_run(write_run(tmp_path / "c", ROWS, final={"faces": 0, "chamfer_ps": None}))
    assert flat.reason == "it ended without a surface"


def test_the_reference_is_the_one_the_run_names_or_the_one_beside_its_data(tmp_path: Path):
    scene, given = tmp_path / "scene", tmp_path / "given.ply"
    scene.mkdir()
    (scene / "gt_mesh.ply").touch()
    assert load_run(write_run(tmp_path / "a", ROWS)).reference is None
    assert load_run(write_run(tmp_path / "b", ROWS, config={"data": str(scene)})).reference == scene / "gt_mesh.ply"
    named = {"data": str(scene), "reference": str(given)}
    assert load_run(write_run(tmp_path / "c", ROWS, config=named)).reference == scene / "gt_mesh.ply", "gone meanwhile"
    given.touch()
    assert load_run(tmp_path / "c").reference == given


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("config.json", "{", r"config\.json cannot be read"),
        ("metrics.json", "[1]", r"metrics\.json holds no JSON object"),
        ("curve.csv", "a,b\n1,2\n", r"curve\.csv is not a curve of a run"),
    ],
)
def test_damage_is_named(tmp_path: Path, name: str, content: str, message: str):
    folder = write_run(tmp_path / "a", ROWS)
    (folder / name).write_text(content, encoding="utf-8")
    with pytest.raises(DataError, match=message):
        load_run(folder)


def test_a_folder_that_is_no_run(tmp_path: Path):
    with pytest.raises(DataError, match="not a run directory"):
        load_run(tmp_path)


def test_time_to_reach_is_exact_for_a_power_law():
    """error = 0.04 / sqrt(t): interpolation on logarithmic scales finds every time between the rows."""
    curve = record([(t, 0.04 / t**0.5) for t in (1.0, 4.0, 16.0)]).curve
    for seconds in (1.0, 1.7, 4.0, 9.0, 16.0):
        assert time_to_reach(curve, 0.04 / seconds**0.5) == pytest.approx(seconds)
    assert time_to_reach(curve, 0.009) == math.inf
    assert time_to_reach(curve, 1.0) == 1, "the first row is the first that is known"
    assert time_to_reach((), 1.0) == math.inf


def test_time_to_reach_counts_the_first_time():
    assert time_to_reach(record([(1.0, 0.4), (2.0, 0.1), (4.0, 0.3)]).curve, 0.1) == 2


def test_time_to_reach_a_score():
    curve = tuple(CurvePoint(train_seconds=t, wall_seconds=10 * t, psnr=p) for t, p in ((1.0, 20.0), (4.0, 24.0)))
    assert time_to_reach(curve, 22.0, measure="psnr") == pytest.approx(2)
    assert time_to_reach(curve, 22.0, measure="psnr", clock="wall") == pytest.approx(20)
    assert time_to_reach(curve, 25.0, measure="psnr") == math.inf
    assert time_to_reach(curve, 0.1) == math.inf, "the Chamfer distance is not known"
