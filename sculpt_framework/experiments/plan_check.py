"""``sculpt-ablate --plan``: what leaving things out has changed, error and time beside the run with everything on."""

import math
from collections.abc import Sequence

from sculpt_framework.comparison.runs import Clock, RunRecord
from sculpt_framework.comparison.statistics import median
from sculpt_framework.experiments.matrix import Budget, Setting
from sculpt_framework.experiments.results import CellResult, records
from sculpt_framework.experiments.tables import UNKNOWN, Table, number

PLANNED, EVERYTHING = "planned", "everything"
FROZEN = {"gaussian-sculpting": "gaussian-sculpting-everything"}
"""Methods whose state before there were plans is kept as a method of its own."""
LEVELS = {PLANNED: {"plan": "on"}, EVERYTHING: {"plan": "off"}}
TIME_MOST, ERROR_MOST = 0.6, 1.03
"""What the planned run may take and how wrong it may be, as shares of the other."""
CHAMFER_UNIT = 1e-2


def plan_settings(method: str) -> tuple[Setting, Setting]:
    """The method with its plan, and with everything on."""
    return (
        Setting(name=PLANNED, method=method, words=("--plan", "on"), replaces=("--plan",)),
        Setting(
            name=EVERYTHING, method=FROZEN.get(method, method), words=("--plan", "off"), replaces=("--plan", "--plan.")
        ),
    )


def plan_tables(results: Sequence[CellResult], budgets: Sequence[Budget | None]) -> list[Table]:
    """For each budget a row per scene, medians over seeds, and one of the medians over scenes of the two ratios."""
    return [_plan_table(results, budget) for budget in budgets]


def _plan_table(results: Sequence[CellResult], budget: Budget | None) -> Table:
    rows, ratios = [], []
    for scene in dict.fromkeys(result.cell.scene for result in results):
        found = records(results, budget=budget.label if budget else "", scene=scene)
        error = {name: _median(found, name, "chamfer_ps", failed=math.inf) for name in LEVELS}
        time = {name: _seconds(found, name, "train") for name in LEVELS}
        work = {name: _seconds(found, name, "cpu") for name in LEVELS}
        memory = {name: _median(found, name, "rss_mb") for name in LEVELS}
        own = [_ratio(each) for each in (error, time, work)]
        ratios.append(own)
        cells = [scene]
        for values, ratio, digits, times in (
            (error, own[0], 3, 1 / CHAMFER_UNIT),
            (time, own[1], 1, 1.0),
            (work, own[2], 1, 1.0),
        ):
            cells += [number(values[name], digits, times=times) for name in (PLANNED, EVERYTHING)]
            cells.append(number(ratio, 2))
        cells += [number(memory[name], 0) for name in (PLANNED, EVERYTHING)]
        rows.append(tuple(cells))
    middle = [median([ratio for ratio in column if ratio is not None]) for column in zip(*ratios, strict=True)]
    blank = ["", ""]
    if middle:
        rows.append(("median", *(cell for ratio in middle for cell in (*blank, number(ratio, 2))), *blank))
    pairs = ("Chamfer, 1e-2", "train s", "CPU s")
    columns = tuple(word for name in pairs for word in (f"{name} planned", EVERYTHING, "ratio"))
    return Table(
        title="The plan against everything on, same seeds" + (f", {budget.phrase} a run" if budget else ""),
        columns=("scene", *columns, "MB planned", EVERYTHING),
        rows=tuple(rows),
    )


def plan_notes() -> list[str]:
    return [
        f"A plan is worth it where the time is at most {TIME_MOST:g} x and the Chamfer distance at most "
        f"{ERROR_MOST:g} x that of everything on; {UNKNOWN}: not known.",
        "Train s are wall seconds of training, evaluation left out; on a machine that others use compare CPU s.",
    ]


def _median(found: Sequence[RunRecord], setting: str, name: str, *, failed: float | None = None) -> float | None:
    """A run that failed counts as ``failed``; as nothing by default: it has not cost what it would have."""
    values = [failed if each.failed else each.final.get(name) for each in found if each.method == setting]
    return median([float(value) for value in values if value is not None])


def _seconds(found: Sequence[RunRecord], setting: str, clock: Clock) -> float | None:
    """Of all processes of a run that was resumed; a failure counts as nothing, as above."""
    values = [each.total_seconds(clock) for each in found if each.method == setting and not each.failed]
    return median([value for value in values if value is not None])


def _ratio(values: dict[str, float | None]) -> float | None:
    planned, everything = values[PLANNED], values[EVERYTHING]
    if planned is None or not everything or math.isinf(everything):
        return None
    return planned / everything
