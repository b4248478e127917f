"""The tables of an ablation: ours, and beside them what the paper has."""

import math
from collections.abc import Sequence

from sculpt_framework.comparison.runs import RunRecord
from sculpt_framework.comparison.statistics import Cell as Summary
from sculpt_framework.comparison.statistics import median, summarize
from sculpt_framework.experiments.ablation import DEFAULT, DISTRIBUTION_OFF, OPACITY_OFF, SCALE_OFF, Ablation
from sculpt_framework.experiments.matrix import Budget
from sculpt_framework.experiments.paper import ABLATION, ABLATION_PLACE, ABLATION_REMARKS
from sculpt_framework.experiments.results import CellResult, median_final, records
from sculpt_framework.experiments.tables import UNKNOWN, Table, number

CHAMFER_UNIT = 1e-2


def ablation_tables(results: Sequence[CellResult], made: Ablation, budgets: Sequence[Budget]) -> list[Table]:
    """For each budget the summary with the paper's figures, then one table per scene with all measures."""
    tables = []
    for budget in budgets:
        tables.append(summary_table(results, made, budget))
        scenes = dict.fromkeys(result.cell.scene for result in results)
        tables += [scene_table(results, made, budget, scene) for scene in scenes]
    return tables


def summary_table(results: Sequence[CellResult], made: Ablation, budget: Budget) -> Table:
    """A row per setting: which constraints are on, the Chamfer distance per scene, how many times the method's own it
    is, and the paper's figure for it."""
    scenes = list(dict.fromkeys(result.cell.scene for result in results))
    found = records(results, budget=budget.label)
    cells = {(cell.method, cell.scene): cell for cell in summarize(found, "chamfer")}
    paper_full = ABLATION["all"]
    rows = []
    for setting in made.settings:
        levels = made.levels[setting.name]
        constraints = levels.get("constraints", "all")
        paper = ABLATION[constraints] if only_constraints(made, setting.name) else None
        rows.append(
            (
                setting.name,
                *(_tick(constraints not in off) for off in (OPACITY_OFF, SCALE_OFF, DISTRIBUTION_OFF)),
                *(_chamfer(cells.get((setting.name, scene))) for scene in scenes),
                number(times_default(found, setting.name, scenes), 2),
                UNKNOWN if paper is None else f"{paper:.2f}",
                UNKNOWN if paper is None else f"{paper / paper_full:.2f}",
            )
        )
    return Table(
        title=f"Equal {budget.kind}, {budget.phrase} a run: Chamfer distance, 1e-2 scene units",
        columns=("setting", "opacity", "scale", "distribution", *scenes, "x default", "paper CD", "x full"),
        rows=tuple(rows),
    )


def scene_table(results: Sequence[CellResult], made: Ablation, budget: Budget, scene: str) -> Table:
    """A row per setting: medians over seeds of everything that is measured."""
    found = records(results, budget=budget.label, scene=scene)
    measured = {
        measure: {cell.method: cell for cell in summarize(found, measure)}
        for measure in ("chamfer", "fscore", "normal_consistency", "psnr", "under10_pct")
    }
    rows = []
    for setting in made.settings:
        own = [record for record in found if record.method == setting.name]

        def value(measure: str, name: str = setting.name) -> float | None:
            cell = measured[measure].get(name)
            return None if cell is None else cell.median

        rows.append(
            (
                setting.name,
                _chamfer(measured["chamfer"].get(setting.name)),
                number(value("fscore"), 3),
                number(value("normal_consistency"), 4),
                number(value("psnr"), 2),
                number(value("under10_pct"), 2),
                number(median_final(own, "faces"), 0),
                number(median_final(own, "outer"), 0),
                number(median_final(own, "t_train_s"), 0),
                f"{len(own)}" + (f", {failures} failed" if (failures := sum(r.failed for r in own)) else ""),
            )
        )
    return Table(
        title=f"{scene}, {budget.phrase}",
        columns=(
            "setting",
            "Chamfer 1e-2",
            "F-score",
            "normals",
            "PSNR dB",
            "< 10° %",
            "faces",
            "outer steps",
            "training s",
            "runs",
        ),
        rows=tuple(rows),
    )


def notes(made: Ablation) -> list[str]:
    """What a reader of the tables must know, a line each."""
    lines = [
        f"paper CD: {ABLATION_PLACE}, 1e-2, mean of five objects at 128^3; its definition of CD and its units are not "
        "given, so compare the columns of ratios, not of distances.",
        "Chamfer, F-score, normals: against the reference mesh, medians over seeds, failures counted as failures; "
        "PSNR: train views that are held out.",
    ]
    for setting in made.settings:
        remark = ABLATION_REMARKS.get(setting.name)
        if remark is not None:
            lines.append(f"{setting.name}: {remark}.")
    lines += [f"{name} is not run: the same as {twin} here." for name, twin in made.same.items()]
    return lines


def only_constraints(made: Ablation, setting: str) -> bool:
    """Whether a setting differs from the method in its constraints at most, as the rows of the paper's table do."""
    own = made.levels[DEFAULT]
    return all(level == own[factor] for factor, level in made.levels[setting].items() if factor != "constraints")


def times_default(found: Sequence[RunRecord], setting: str, scenes: Sequence[str]) -> float | None:
    """How many times the method's own error a setting has: the geometric mean over scenes of the ratio of medians.

    Both medians are over the seeds that both have run. Infinite if the setting failed on a scene; None where there is
    nothing to compare.
    """
    logs = []
    for scene in scenes:
        values = {
            name: {
                record.seed: value
                for record in found
                if (record.method, record.scene) == (name, scene) and (value := record.result("chamfer")) is not None
            }
            for name in (setting, DEFAULT)
        }
        seeds = values[setting].keys() & values[DEFAULT].keys()
        error, own = (median([values[name][seed] for seed in seeds]) for name in (setting, DEFAULT))
        if not error or not own or math.isinf(own):
            return None
        if math.isinf(error):
            return math.inf
        logs.append(math.log(error / own))
    return math.exp(sum(logs) / len(logs)) if logs else None


def _chamfer(cell: Summary | None) -> str:
    if cell is None:
        return UNKNOWN
    text = number(cell.median, 3, times=1 / CHAMFER_UNIT)
    if cell.low is not None and cell.high is not None:
        ends = (number(end, 3, times=1 / CHAMFER_UNIT) for end in (cell.low, cell.high))
        text += f" [{' to '.join(ends)}]"
    if cell.failures and cell.failures < cell.runs:
        text += f" ({cell.failures} of {cell.runs} failed)"
    return text


def _tick(on: bool) -> str:
    return "yes" if on else "no"
