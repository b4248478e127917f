"""What came out of the runs of a matrix, as records that sculpt_framework.comparison can count."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sculpt_framework.comparison.runs import Clock, Measure, RunRecord, load_run
from sculpt_framework.comparison.statistics import median
from sculpt_framework.errors import DataError
from sculpt_framework.experiments.ledger import CellState, Ledger
from sculpt_framework.experiments.matrix import Cell, Matrix
from sculpt_framework.experiments.runner import run_folder

MEASURES: tuple[Measure, ...] = ("chamfer", "fscore", "normal_consistency", "psnr", "ssim", "iou", "under10_pct")
_FINALS = ("outer", "inner", "faces", "gaussians", "grid", "t_train_s", "t_wall_s", "t_cpu_s", "rss_mb")
_CLOCKS: Mapping[str, Clock] = {"t_train_s": "train", "t_wall_s": "wall", "t_cpu_s": "cpu"}


@dataclass(frozen=True, kw_only=True)
class CellResult:
    """A cell, and its run as a record whose method is the cell's setting and whose scene is the cell's."""

    cell: Cell
    state: CellState
    record: RunRecord | None
    """None where there is no answer yet. A failure is an answer."""


def read_results(matrix: Matrix, folder: Path) -> tuple[CellResult, ...]:
    """The results of a matrix's cells, in its order; of those that have not ended, too.

    Raises ConfigError where the folder holds something else.
    """
    ledger = Ledger(folder)
    return tuple(
        CellResult(
            cell=cell,
            state=ledger.get(cell.name),
            record=_record(cell, ledger.get(cell.name), run_folder(folder, cell)),
        )
        for cell in matrix.cells
    )


def _record(cell: Cell, state: CellState, run_dir: Path) -> RunRecord | None:
    if state.status not in ("finished", "failed"):
        return None
    failed = RunRecord(
        name=cell.name, scene=cell.scene, method=cell.setting, seed=cell.seed, failed=True, reason=state.error
    )
    if state.status == "failed":
        return failed
    try:
        record = load_run(run_dir)
    except DataError as error:
        return replace(failed, reason=str(error))
    return replace(record, name=cell.name, scene=cell.scene, method=cell.setting, seed=cell.seed)


def records(results: Sequence[CellResult], *, budget: str | None = None, scene: str | None = None) -> list[RunRecord]:
    """The records there are, of a budget and a scene; what is None is not asked for."""
    return [
        result.record
        for result in results
        if result.record is not None
        and (budget is None or budget_label(result.cell) == budget)
        and (scene is None or result.cell.scene == scene)
    ]


def told_apart(results: Sequence[CellResult]) -> list[CellResult]:
    """The same; where there is more than one budget, each setting's name ends in that of its budget."""
    if len({result.cell.budget for result in results}) < 2:
        return list(results)
    return [_with_budget(result) for result in results]


def _with_budget(result: CellResult) -> CellResult:
    budget, record = result.cell.budget, result.record
    name = f"{result.cell.setting}, {budget.phrase if budget else 'its own length'}"
    return replace(
        result,
        cell=replace(result.cell, setting=name),
        record=None if record is None else replace(record, method=name),
    )


def median_final(found: Sequence[RunRecord], name: str) -> float | None:
    """Median of a figure of metrics.json over the runs that have it; failures have none."""
    values = [record.final.get(name) for record in found if not record.failed]
    return median([float(value) for value in values if value is not None])


def budget_label(cell: Cell) -> str:
    return cell.budget.label if cell.budget else ""


def results_csv(results: Sequence[CellResult], levels: Mapping[str, Mapping[str, str]]) -> str:
    """One line per run. ``levels`` gives further columns by setting. Blank: not known."""
    factors = list(dict.fromkeys(factor for names in levels.values() for factor in names))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["scene", "budget", "setting", *factors, "seed", "status", *MEASURES, *_FINALS, "error"])
    for result in results:
        cell, record, named = result.cell, result.record, levels.get(result.cell.setting, {})
        ended = None if record is None or record.failed else record
        writer.writerow(
            [
                *(cell.scene, budget_label(cell), cell.setting, *(named.get(factor, "") for factor in factors)),
                *(cell.seed, result.state.status),
                *(_cell(ended.result(measure) if ended else None) for measure in MEASURES),
                *(_cell(_final(ended, name) if ended else None) for name in _FINALS),
                (record.reason if record is not None else result.state.error) or "",
            ]
        )
    return out.getvalue()


def _final(record: RunRecord, name: str) -> float | int | None:
    """A figure of metrics.json, but seconds of all processes of a run that was resumed."""
    return record.total_seconds(_CLOCKS[name]) if name in _CLOCKS else record.final.get(name)


def _cell(value: float | int | None) -> str:
    if value is None or not math.isfinite(value):
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"
