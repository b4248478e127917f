"""The tables of a suite: ours, and the paper's with the same columns below."""

import math
import statistics
from collections.abc import Mapping, Sequence

from sculpt_framework.comparison.statistics import Cell as Summary
from sculpt_framework.comparison.statistics import summarize
from sculpt_framework.experiments.paper import PaperTable, median_with_failures
from sculpt_framework.experiments.results import CellResult, median_final, records
from sculpt_framework.experiments.suites import Suite, paper_column
from sculpt_framework.experiments.tables import UNKNOWN, Table, number, power

COUNTED = ("mean", "median", "failures", "wins")


def suite_tables(results: Sequence[CellResult], suite: Suite) -> list[Table]:
    """Ours, the paper's if it has any, and one table per scene with all measures."""
    methods = list(dict.fromkeys(result.cell.setting for result in results))
    tables = [our_table(results, suite, methods)]
    if suite.paper is not None:
        tables.append(paper_table(suite.paper))
    return tables + [scene_table(results, scene.label, methods) for scene in suite.scenes]


def our_table(results: Sequence[CellResult], suite: Suite, methods: Sequence[str]) -> Table:
    """Chamfer distances, a row per method. Its columns are the paper's where there is a table of the paper."""
    cells = {(cell.method, cell.scene): cell for cell in summarize(records(results), "chamfer")}
    columns = suite.columns if suite.paper is None else suite.paper.objects
    scene_of = _scene_of(suite, columns)
    rows = []
    for method in methods:
        found = [cells.get((method, scene_of[column])) if column in scene_of else None for column in columns]
        known = [cell.median for cell in found if cell is not None and cell.median is not None]
        failures = sum(cell.failures for cell in found if cell is not None)
        wins = sum(cell.best for cell in found if cell is not None)
        rows.append(
            (
                method,
                *(_chamfer(cell, suite.unit) for cell in found),
                number(statistics.fmean(known) if known else None, 2, times=1 / suite.unit),
                number(statistics.median(known) if known else None, 2, times=1 / suite.unit),
                str(failures) if known else UNKNOWN,
                str(wins) if known and len(methods) > 1 else UNKNOWN,
            )
        )
    return Table(
        title=f"Ours: Chamfer distance, point to surface, {power(suite.unit)} scene units",
        columns=("method", *columns, *COUNTED),
        rows=tuple(rows),
    )


def paper_table(paper: PaperTable) -> Table:
    """The paper's table with its figures as printed, and medians, failures and wins counted from them."""
    wins = paper.wins()
    return Table(
        title=f"The paper: CD as printed, {power(paper.unit)}. {paper.place}",
        columns=("method", *paper.objects, *COUNTED),
        rows=tuple(
            (
                name,
                *(number(math.inf if value is None else value, 2) for value in row),
                f"{paper.means[name]:.2f}",
                number(median_with_failures(row), 2),
                str(paper.failures(name)),
                str(wins[name]),
            )
            for name, row in paper.rows.items()
        ),
    )


def scene_table(results: Sequence[CellResult], scene: str, methods: Sequence[str]) -> Table:
    """All measures on one scene, medians over seeds."""
    found = records(results, scene=scene)
    measured = {
        measure: {cell.method: cell for cell in summarize(found, measure)}
        for measure in ("chamfer", "fscore", "normal_consistency", "psnr", "iou", "under10_pct")
    }
    digits: Mapping[str, int] = {"chamfer": 5, "fscore": 3, "normal_consistency": 4, "psnr": 2, "iou": 4}
    rows = []
    for method in methods:
        own = [record for record in found if record.method == method]
        medians = [
            number(cell.median if (cell := cells.get(method)) else None, digits.get(measure, 2))
            for measure, cells in measured.items()
        ]
        seconds = number(median_final(own, "t_train_s"), 0)
        failed = sum(record.failed for record in own)
        runs = f"{len(own)}" + (f", {failed} failed" if failed else "")
        rows.append((method, *medians, number(median_final(own, "faces"), 0), seconds, runs))
    columns = ("method", "Chamfer", "F-score", "normals", "PSNR dB", "IoU", "< 10° %", "faces", "training s", "runs")
    return Table(title=scene, columns=columns, rows=tuple(rows))


def notes(suite: Suite) -> list[str]:
    """What a reader of the tables must know, a line each."""
    lines = [
        "ours: medians over seeds; mean and median over objects count a failure as a failure. wins: objects on which "
        "no other row of the same table is better."
    ]
    if suite.paper is not None:
        lines.append(
            "the paper does not define its CD and its units, and its means leave failures out: read its table for the "
            "order of its methods, not against ours figure by figure. docs/laboratory/experiments.md lists what is "
            "odd in it."
        )
    if suite.name == "omniobject3d":
        lines.append("the paper names categories and not scans: these objects need not be its own.")
    if suite.missing:
        lines.append(f"not in the folder: {', '.join(suite.missing)}.")
    return lines


def _scene_of(suite: Suite, columns: Sequence[str]) -> dict[str, str]:
    """Labels of scenes by the table's columns. Scenes outside the paper's table have none; their own tables remain."""
    found: dict[str, str] = {}
    for scene, column in zip(suite.scenes, suite.columns, strict=True):
        if suite.paper is None:
            found[column] = scene.label
        elif (place := paper_column(suite.paper, column)) is not None:
            found.setdefault(columns[place], scene.label)
    return found


def _chamfer(cell: Summary | None, unit: float) -> str:
    if cell is None:
        return UNKNOWN
    text = number(cell.median, 2, times=1 / unit)
    return f"{text} ({cell.failures} of {cell.runs} failed)" if 0 < cell.failures < cell.runs else text
