"""What came out of a batch: a row per scene, failures by name, and all runs on one page."""

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sculpt_framework.comparison.pages import compare, write_comparison
from sculpt_framework.errors import DataError, TrainingFailed
from sculpt_framework.experiments.results import CellResult, results_csv
from sculpt_framework.experiments.runner import RUNS
from sculpt_framework.experiments.tables import Table, number

REPORT = "report"
_SHOWN_AT_MOST = 50
"""Rows of the table that is printed; results.csv has all."""
_MEASURES = (
    ("Chamfer", "chamfer_ps", 5),
    ("PSNR dB", "psnr", 2),
    ("faces", "faces", 0),
    ("training s", "t_train_s", 0),
)


def batch_tables(results: Sequence[CellResult]) -> tuple[list[Table], list[str], str]:
    """Tables, notes and the text of results.csv, as ``carry_out`` wants them."""
    made = [scene_table(results)]
    failed = failures(results)
    if failed:
        made.append(Table(title=f"{len(failed)} failed", columns=("scene", "last line of its log"), rows=tuple(failed)))
    return made, notes(results), results_csv(results, {})


def scene_table(results: Sequence[CellResult]) -> Table:
    """One row per scene; of more than can be read, the first and the medians of all."""
    shown = [(each.cell.scene, each.record.final) for each in results if each.record and not each.record.failed]
    rows = [
        (scene, *(number(_figure(final, key), digits) for _, key, digits in _MEASURES))
        for scene, final in shown[:_SHOWN_AT_MOST]
    ]
    known = {
        key: [value for _, final in shown if (value := _figure(final, key)) is not None] for _, key, _ in _MEASURES
    }
    medians = [number(statistics.median(known[key]) if known[key] else None, digits) for _, key, digits in _MEASURES]
    rows.append((f"median of {len(shown)}", *medians))
    return Table(title="Finished", columns=("scene", *(name for name, _, _ in _MEASURES)), rows=tuple(rows))


def failures(results: Sequence[CellResult]) -> list[tuple[str, str]]:
    """Name and reason of every scene that failed."""
    return [
        (result.cell.scene, result.record.reason or "")
        for result in results
        if result.record is not None and result.record.failed
    ]


def notes(results: Sequence[CellResult]) -> list[str]:
    """How many there are of what, and where the log of a failure is."""
    failed = failures(results)
    left = sum(result.record is None for result in results)
    lines = [f"{len(results) - len(failed) - left} of {len(results)} scenes finished, {len(failed)} failed."]
    if left:
        lines.append(f"{left} are still to be run; the same command goes on.")
    if failed:
        lines.append(f"the whole log of a scene is {RUNS}/SCENE.log; --retry-failed runs those that failed again.")
    return lines


def write_report(results: Sequence[CellResult], folder: Path, title: str) -> Path | None:
    """Error against time of all scenes on one page; None where no run has anything to show."""
    records = [result.record for result in results if result.record is not None]
    try:
        comparison = compare(records)
    except DataError:
        return None
    return write_comparison(comparison, folder / REPORT, title)[0]


def require_all(results: Sequence[CellResult], folder: Path) -> None:
    """Raise TrainingFailed, with names, where a scene failed: whoever called must see that not all is there."""
    failed = failures(results)
    if failed:
        told = "; ".join(f"{name}: {reason}" for name, reason in failed[:5]) + ("; ..." if len(failed) > 5 else "")
        raise TrainingFailed(f"{len(failed)} of {len(results)} scenes failed: {told}. Logs are in {folder / RUNS}")


def _figure(final: Mapping[str, Any], key: str) -> float | None:
    value = final.get(key)
    return None if value is None else float(value)
