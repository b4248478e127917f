"""What the recorder leaves in a run directory."""

import json
import math
from pathlib import Path

import pytest

from sculpt_framework.errors import DataError, OutputError
from sculpt_framework.evaluation.curve import CURVE_COLUMNS, header_line, read_curve, row_line
from sculpt_framework.events import Event
from sculpt_plugins.observers.recorder.config import RecorderConfig

COLUMNS = (
    "t_train_s,t_wall_s,t_cpu_s,outer,inner,faces,gaussians,grid,rss_mb,"
    "psnr,ssim,iou,chamfer_ps,fscore,normal_consistency,under10_pct,"
    "psnr_fitted,residual_px,residual_p90_px,residual_depth,judged,roughness,plain_roughness"
)


def event(name: str, t_train: float = 1.0, outer: int = 3, **data: object) -> Event:
    return Event(t_train=t_train, t_wall=t_train + 2.0, outer=outer, event=name, data=data)


def record(run_dir: Path, *events: Event, **options: float) -> None:
    observer = RecorderConfig(**options).build(run_dir)
    for each in events:
        observer.notify(each)
    observer.close()


def lines(run_dir: Path) -> list[dict]:
    return [json.loads(line) for line in (run_dir / "events.jsonl").read_text(encoding="utf-8").splitlines()]


def test_events_are_json_lines_of_version_1(tmp_path: Path):
    record(
        tmp_path,
        event("run_started", t_train=0.0, method="m", notes=["one"]),
        event("snapshot", reconstruction=object()),
        event("warning", text="not finite", value=math.nan),
    )
    first, second = lines(tmp_path)
    assert first == {
        "v": 1,
        "t_train": 0.0,
        "t_wall": 2.0,
        "outer": 3,
        "event": "run_started",
        "data": {"method": "m", "notes": ["one"]},
    }
    assert second["data"] == {"text": "not finite", "value": None}


def test_outer_steps_are_thinned_and_others_are_not(tmp_path: Path):
    steps = [event("outer_step", t_train=0.1 * i, outer=i) for i in range(50)]
    record(tmp_path, *steps, event("stage"), event("stage"), step_seconds=1.0)
    kept = [line for line in lines(tmp_path) if line["event"] == "outer_step"]
    assert 4 <= len(kept) <= 6
    assert kept[0]["outer"] == 0
    assert len(lines(tmp_path)) == len(kept) + 2


def test_every_line_is_on_disk_at_once(tmp_path: Path):
    observer = RecorderConfig().build(tmp_path)
    observer.notify(event("run_started"))
    observer.notify(event("evaluation", psnr=20.0))
    assert len(lines(tmp_path)) == 2
    assert len(read_curve(tmp_path / "curve.csv")) == 1
    observer.close()


def test_the_curve_has_the_agreed_columns_and_blanks(tmp_path: Path):
    record(
        tmp_path,
        event("run_started", t_train=0.0),
        event("evaluation", t_train=1.25, psnr=21.5, chamfer_ps=None, faces=1000, reason="time", ssim=math.inf),
    )
    header, row = (tmp_path / "curve.csv").read_text(encoding="utf-8").splitlines()
    assert header == COLUMNS == ",".join(CURVE_COLUMNS)
    assert row == "1.25,3.25,,3,,1000,,,,21.5" + "," * 13
    (read,) = read_curve(tmp_path / "curve.csv")
    assert read["faces"] == 1000
    assert read["chamfer_ps"] is None


def test_a_curve_of_an_older_version_is_read(tmp_path: Path):
    """As they were before photographs were measured against: a column fewer each."""
    columns = COLUMNS.split(",psnr_fitted")[0]
    (tmp_path / "curve.csv").write_text(f"{columns}\n1.5{',' * 8},20.5,,,0.01,,,0.3\n", encoding="utf-8")
    (read,) = read_curve(tmp_path / "curve.csv")
    assert list(read) == list(CURVE_COLUMNS)
    assert (read["t_train_s"], read["psnr"], read["under10_pct"]) == (1.5, 20.5, 0.3)
    assert read["residual_px"] is None
    # Resumed, it gets the columns it has not had.
    record(tmp_path, event("run_started", t_train=0.0), event("evaluation", t_train=2.0, residual_px=0.25))
    assert [row["residual_px"] for row in read_curve(tmp_path / "curve.csv")] == [None, 0.25]


def test_a_resumed_run_keeps_the_clock_monotone(tmp_path: Path):
    record(
        tmp_path,
        event("run_started", t_train=0.0),
        *(event("evaluation", t_train=t, psnr=t) for t in (1.0, 2.0, 4.0)),
    )
    with (tmp_path / "curve.csv").open("a") as file:
        file.write("7.5,9")
    with (tmp_path / "events.jsonl").open("a") as file:
        file.write('{"v": 1, "t_tr')
    record(
        tmp_path,
        event("run_started", t_train=0.0),
        event("stage", t_train=2.5),
        event("evaluation", t_train=4.5, psnr=9.0),
    )
    assert [row["t_train_s"] for row in read_curve(tmp_path / "curve.csv")] == [1.0, 2.0, 4.5]
    broken = [
        line for line in (tmp_path / "events.jsonl").read_text(encoding="utf-8").splitlines() if not line.endswith("}")
    ]
    assert broken == ['{"v": 1, "t_tr']


def test_metrics_at_the_end(tmp_path: Path):
    record(
        tmp_path,
        event("run_started", t_train=0.0, method="m", scene="s", seed=7, device="cpu"),
        event(
            "run_ended",
            t_train=9.0,
            status="finished",
            final={"psnr": 30.0, "chamfer_ps": 0.002, "reason": "end", "point_to_point": 0.004, "iou": math.nan},
            certificate={"watertight": True, "genus": 0},
            milestones=[{"share": 1.0, "psnr": 30.0}],
        ),
    )
    metrics = json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["schema"] == 1
    assert metrics["status"] == "finished"
    assert metrics["seed"] == 7
    assert metrics["final"] == {
        **dict.fromkeys(CURVE_COLUMNS),
        "t_train_s": 9.0,
        "t_wall_s": 11.0,
        "outer": 3,
        "psnr": 30.0,
        "chamfer_ps": 0.002,
        "point_to_point": 0.004,
    }
    assert metrics["certificate"]["watertight"] is True
    assert metrics["versions"]["numpy"]
    assert metrics["versions"]["python"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_full_disk_is_one_clear_line(tmp_path: Path):
    (tmp_path / "events.jsonl").symlink_to("/dev/full")
    observer = RecorderConfig().build(tmp_path)
    with pytest.raises(OutputError, match=r"events\.jsonl \(No space left"):
        observer.notify(event("stage"))
    observer.close()


def test_what_is_not_a_curve_is_refused(tmp_path: Path):
    path = tmp_path / "curve.csv"
    with pytest.raises(DataError, match="cannot read"):
        read_curve(path)
    path.write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(DataError, match="no column"):
        read_curve(path)
    path.write_text(header_line() + row_line({"psnr": 1.0}).replace("1,", "one,"), encoding="utf-8")
    with pytest.raises(DataError, match="line 2"):
        read_curve(path)
