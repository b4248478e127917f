"""Run directories as sculpt-train leaves them, written by hand: what is in them is known."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sculpt_framework.comparison.runs import CurvePoint, RunRecord
from sculpt_framework.evaluation.curve import header_line, row_line

CONFIG = {
    "version": 1,
    "method": "sculpting",
    "data": "scenes/jar",
    "seed": 0,
    "reference": None,
    "threads": None,
    "field": {"type": "hash-grid", "num_levels": 7},
    "extractor": {"type": "flexicubes"},
    "losses": [{"type": "photometric", "weight": 1.0}],
    "steps": 4,
    "trainer": {"warm_start": True},
}


def row(seconds: float, chamfer: float | None, **more: float) -> dict[str, float | None]:
    return {"t_train_s": seconds, "t_wall_s": 2 * seconds, "t_cpu_s": 3 * seconds, "chamfer_ps": chamfer, **more}


def write_run(
    folder: Path,
    rows: Sequence[Mapping[str, float | None]],
    *,
    status: str | None = "finished",
    config: Mapping[str, Any] | None = None,
    final: Mapping[str, Any] | None = None,
    events: Sequence[Mapping[str, Any]] = (),
    scene: str = "jar",
    inputs: Mapping[str, str] | None = None,
) -> Path:
    """Without a status: a run that was killed."""
    folder.mkdir(parents=True)
    settings = {**CONFIG, **(config or {})}
    (folder / "config.json").write_text(json.dumps(settings), encoding="utf-8")
    (folder / "curve.csv").write_text(header_line() + "".join(map(row_line, rows)), encoding="utf-8")
    started = {"scene": scene, "device": "cpu", "inputs": inputs or {}}
    lines = [{"event": "run_started", "t_train": 0.0, "t_wall": 1.0, "data": started}, *events]
    (folder / "events.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    if status is not None:
        metrics = {
            "status": status,
            "scene": scene,
            "method": settings["method"],
            "seed": settings["seed"],
            "device": "cpu",
            "final": {"faces": 100, **rows[-1], **(final or {})},
            "certificate": {"watertight": True},
            "versions": {"torch": "2.13"},
        }
        (folder / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    return folder


def record(
    errors: Sequence[tuple[float, float]],
    *,
    method: str = "ours",
    scene: str = "jar",
    seed: int = 0,
    failed: bool = False,
    psnr: float | None = None,
) -> RunRecord:
    """A run with a curve of (training seconds, Chamfer distance), whose result is its end."""
    points = tuple(CurvePoint(train_seconds=seconds, chamfer=error) for seconds, error in errors)
    final = {"t_train_s": errors[-1][0], "chamfer_ps": errors[-1][1], "psnr": psnr} if errors else {}
    return RunRecord(
        name=f"{method}-{scene}-{seed}",
        scene=scene,
        method=method,
        seed=seed,
        curve=points,
        final={} if failed else final,
        failed=failed,
        reason="it broke" if failed else None,
    )
