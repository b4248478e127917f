"""What a run directory holds, as typed records: of finished, stopped, failed, killed and running runs alike."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.curve import CurveRow, read_curve

Clock = Literal["train", "wall", "cpu"]
"""Which seconds: training alone, since the process started, or CPU seconds of all threads."""
Measure = Literal["chamfer", "fscore", "normal_consistency", "psnr", "ssim", "iou", "under10_pct", "residual_px"]
HIGHER_IS_BETTER: frozenset[Measure] = frozenset({"fscore", "normal_consistency", "psnr", "ssim", "iou"})


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """One row of curve.csv; None where a value is not known. Times in seconds, lengths in scene units."""

    train_seconds: float
    wall_seconds: float | None = None
    cpu_seconds: float | None = None
    step: int | None = None
    """Outer steps so far."""
    inner_steps: int | None = None
    stage: int | None = None
    """Index of the stage the row was measured in, from 0; None where events.jsonl does not tell."""
    faces: int | None = None
    gaussians: int | None = None
    grid: int | None = None
    """Cells of the extraction grid along its longest side."""
    memory_mib: float | None = None
    psnr: float | None = None
    """Held-out train views, dB."""
    ssim: float | None = None
    iou: float | None = None
    chamfer: float | None = None
    """Point to surface, mean of both directions."""
    fscore: float | None = None
    normal_consistency: float | None = None
    under10_pct: float | None = None
    residual_px: float | None = None
    """Median displacement left between photographs; of runs without a reference."""

    def seconds(self, clock: Clock) -> float | None:
        return {"train": self.train_seconds, "wall": self.wall_seconds, "cpu": self.cpu_seconds}[clock]

    def value(self, measure: Measure) -> float | None:
        return getattr(self, measure)


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """A run, or a mesh somebody else made, ready to be compared."""

    name: str
    """What people call this one run; unique among the runs of a comparison."""
    scene: str
    method: str
    """What is compared: records of one method and scene differ by their seed."""
    seed: int | None = None
    folder: Path | None = None
    """The run directory; None for an external mesh."""
    curve: tuple[CurvePoint, ...] = ()
    """In the order of training seconds. The last point of a run that ended has the measures of ``final``, which come
    from more samples."""
    final: Mapping[str, Any] = field(default_factory=dict)
    """Measures of the result by the names of metrics.json: numbers, None where not known, F-scores by threshold.
    Empty where the run did not end."""
    certificate: Mapping[str, Any] | None = None
    failed: bool = False
    """No result to be counted: failed, stopped, killed, or not ended yet."""
    reason: str | None = None
    """Why ``failed``, in one line."""
    device: str | None = None
    versions: Mapping[str, str | None] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    """config.json as it is: JSON values."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 digests of what the run read, by kind; empty where it did not tell."""
    reference: Path | None = None
    """The mesh the run was measured against, where it is still there."""

    def result(self, measure: Measure) -> float | None:
        """The measure of the result: infinitely bad for a failure, None where it is not known."""
        if self.failed:
            return -math.inf if measure in HIGHER_IS_BETTER else math.inf
        return self.final.get(_FINAL_NAMES.get(measure, measure))

    def total_seconds(self, clock: Clock) -> float | None:
        """Seconds to the result; None where that is not known. A failure has those it took to fail."""
        known = (self.final.get(_CLOCK_COLUMNS[clock]), self.curve[-1].seconds(clock) if self.curve else None)
        # The end comes after the last row; of a resumed run it knows the last process alone.
        return max((value for value in known if value is not None), default=None)


_CLOCK_COLUMNS: Mapping[Clock, str] = {"train": "t_train_s", "wall": "t_wall_s", "cpu": "t_cpu_s"}
_FINAL_NAMES: Mapping[Measure, str] = {"chamfer": "chamfer_ps"}


def load_run(folder: Path) -> RunRecord:
    """Read config.json, curve.csv, metrics.json and events.jsonl of a run directory, as far as they are there.

    A run that failed, was killed or goes on is read too and comes back with ``failed``. ``name`` is the folder's.
    Raises DataError where the folder is not a run directory or a file in it is damaged.
    """
    if not (folder / "config.json").is_file():
        raise DataError(
            f"{folder} is not a run directory: it has no config.json; expected what sculpt-train left there"
        )
    config = _read_object(folder / "config.json")
    metrics = _read_object(folder / "metrics.json") if (folder / "metrics.json").is_file() else {}
    events = tuple(_events(folder / "events.jsonl"))
    started = _latest(events, "run_started")
    rows = read_curve(folder / "curve.csv") if (folder / "curve.csv").is_file() else []
    reason = _failure(metrics, _latest(events, "run_ended"), rows)
    seed = metrics.get("seed", config.get("seed"))
    final = dict(metrics.get("final") or {})
    return RunRecord(
        name=folder.resolve().name,
        scene=str(metrics.get("scene") or started.get("scene") or _scene_of(config)),
        method=str(config.get("method") or metrics.get("method") or "unnamed"),
        seed=None if seed is None else int(seed),
        folder=folder,
        curve=_with_result(curve_points(rows, events), final),
        final=final,
        certificate=metrics.get("certificate"),
        failed=reason is not None,
        reason=reason,
        device=metrics.get("device") or started.get("device"),
        versions=dict(metrics.get("versions") or {}),
        config=config,
        inputs=dict(started.get("inputs") or {}),
        reference=_reference(config, started),
    )


def curve_points(rows: Sequence[CurveRow], events: Iterable[Mapping[str, Any]] = ()) -> tuple[CurvePoint, ...]:
    """Rows of curve.csv as points; the stage of each is that of the latest "stage" event before it.

    Wall and CPU seconds of a resumed run start anew in the file; here they go on.
    """
    stages = [(event.get("t_train", 0.0), event["data"]["index"]) for event in events if event["event"] == "stage"]
    rows = sorted((row for row in rows if row["t_train_s"] is not None), key=lambda row: row["t_train_s"] or 0.0)
    wall, cpu = _going_on([row["t_wall_s"] for row in rows]), _going_on([row["t_cpu_s"] for row in rows])
    points = []
    for row, wall_seconds, cpu_seconds in zip(rows, wall, cpu, strict=True):
        seconds = row["t_train_s"] or 0.0
        # Events carry four decimals, rows six digits: half a millisecond is nobody's stage.
        stage = next((index for begun, index in reversed(stages) if begun <= seconds + 5e-4), None)
        points.append(
            CurvePoint(
                train_seconds=seconds,
                wall_seconds=wall_seconds,
                cpu_seconds=cpu_seconds,
                step=_whole(row["outer"]),
                inner_steps=_whole(row["inner"]),
                stage=stage,
                faces=_whole(row["faces"]),
                gaussians=_whole(row["gaussians"]),
                grid=_whole(row["grid"]),
                memory_mib=row["rss_mb"],
                psnr=row["psnr"],
                ssim=row["ssim"],
                iou=row["iou"],
                chamfer=row["chamfer_ps"],
                fscore=row["fscore"],
                normal_consistency=row["normal_consistency"],
                under10_pct=row["under10_pct"],
                residual_px=row["residual_px"],
            )
        )
    return tuple(points)


def _going_on(seconds: Sequence[float | None]) -> list[float | None]:
    """A clock that starts anew in the middle, as one that goes on where it was."""
    out: list[float | None] = []
    before, latest = 0.0, 0.0
    for value in seconds:
        if value is not None and value < latest:
            before += latest
        latest = latest if value is None else value
        out.append(None if value is None else before + value)
    return out


def _with_result(curve: tuple[CurvePoint, ...], final: Mapping[str, Any]) -> tuple[CurvePoint, ...]:
    """The curve, ending with the measures of the result where its last row was measured at the same time."""
    ended = final.get("t_train_s")
    if not curve or ended is None or abs(curve[-1].train_seconds - ended) > 1e-3 * max(1.0, ended):
        return curve
    names = ("psnr", "ssim", "iou", "fscore", "normal_consistency", "under10_pct")
    known = {name: final[name] for name in names if final.get(name) is not None}
    if final.get("chamfer_ps") is not None:
        known["chamfer"] = final["chamfer_ps"]
    return (*curve[:-1], replace(curve[-1], **known))


def time_to_reach(
    curve: Sequence[CurvePoint], error: float, *, measure: Measure = "chamfer", clock: Clock = "train"
) -> float:
    """Seconds until the measure first was ``error`` or better; infinite if it never was.

    Between the last row that is worse and the first that is not, the time is interpolated: in log time, and in log
    error for a positive error measure (in the plain value for a score). Before the first row nothing is known: a run
    that starts better has the time of that row.
    """
    higher = measure in HIGHER_IS_BETTER
    before: tuple[float, float] | None = None
    for point in curve:
        value, seconds = point.value(measure), point.seconds(clock)
        if value is None or seconds is None:
            continue
        if (value >= error) if higher else (value <= error):
            return seconds if before is None else _between(before, (seconds, value), error, log=not higher)
        before = (seconds, value)
    return math.inf


def _between(before: tuple[float, float], after: tuple[float, float], error: float, *, log: bool) -> float:
    (t0, e0), (t1, e1) = before, after
    if log and min(e0, e1, error) > 0:
        e0, e1, error = math.log(e0), math.log(e1), math.log(error)
    share = (error - e0) / (e1 - e0)
    if t0 <= 0:
        return t0 + share * (t1 - t0)
    return t0 * (t1 / t0) ** share


def _failure(metrics: Mapping[str, Any], ended: Mapping[str, Any], rows: Sequence[CurveRow]) -> str | None:
    """Why there is no result to count; None where there is one."""
    status = metrics.get("status")
    if status == "finished":
        return None if (metrics.get("final") or {}).get("faces") != 0 else "it ended without a surface"
    if status == "stopped":
        return "stopped before its end"
    if status == "failed":
        return str(ended.get("failure") or "training failed")
    last = max((row["t_train_s"] or 0.0 for row in rows), default=None)
    return "not ended, and nothing was measured" if last is None else f"not ended; last measured after {last:g} s"


def _reference(config: Mapping[str, Any], started: Mapping[str, Any]) -> Path | None:
    """The reference mesh the run names; else the one given to it, or beside its data."""
    named = (started.get("reference"), config.get("reference"), Path(str(config.get("data") or "")) / "gt_mesh.ply")
    return next((path for path in (Path(each) for each in named if each) if path.is_file()), None)


def _scene_of(config: Mapping[str, Any]) -> str:
    data = str(config.get("data") or "")
    return data.removeprefix("demo:") if data.startswith("demo:") else Path(data).name or "scene"


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)


def _latest(events: Sequence[Mapping[str, Any]], name: str) -> Mapping[str, Any]:
    return next((event.get("data") or {} for event in reversed(events) if event.get("event") == name), {})


def _events(path: Path) -> Iterator[Mapping[str, Any]]:
    """Events of a run; a line that was cut when it was killed is passed over."""
    if not path.is_file():
        return
    with open(path, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            try:
                event = json.loads(line)
            except ValueError:
                continue
            if isinstance(event, dict) and "event" in event:
                yield event


def _read_object(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({error}); it should be as the run wrote it") from error
    if not isinstance(value, dict):
        raise DataError(f"{path} holds no JSON object; it should be as the run wrote it")
    return value
