"""Results as tables, and tables as CSV, Markdown and LaTeX."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sculpt_framework.comparison.runs import Clock, Measure, RunRecord
from sculpt_framework.comparison.statistics import Cell, Overall
from sculpt_framework.comparison.wording import CLOCKS, MEASURES, shown
from sculpt_framework.evaluation.charts import number

Value = str | int | float | None


@dataclass(frozen=True)
class Column:
    key: str
    """For programs."""
    heading: str = ""
    """For people; a column without one is only for programs."""
    if_any: bool = False
    """Left out for people where no row has anything in it."""
    marks: bool = False
    """Bold in the rows that stand out."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """``values`` are for programs, ``texts`` for people; both have a cell per column."""

    caption: str
    columns: Sequence[Column]
    values: Sequence[Sequence[Value]]
    texts: Sequence[Sequence[str]]
    strong: Sequence[bool]
    """Rows that stand out."""


def results_table(
    cells: Sequence[Cell],
    targets: Mapping[str, float | None],
    reached: Mapping[tuple[str, str], float | None],
    measure: Measure,
    clock: Clock,
) -> Table:
    """A row per scene and method. ``targets`` by scene, ``reached`` seconds by (scene, method)."""
    columns = (
        Column("scene", "scene"),
        Column("method", "method", marks=True),
        Column("runs", "runs"),
        Column("failures", "failed"),
        Column("unknown", "not known", if_any=True),
        Column("median", f"median {MEASURES[measure].label}", marks=True),
        Column("low", "95 % interval", if_any=True),
        Column("high"),
        Column("seconds", CLOCKS[clock]),
        Column("target", "target", if_any=True),
        Column("seconds_to_target", "s to target", if_any=True),
    )
    values, texts = [], []
    for cell in cells:
        target, seconds = targets.get(cell.scene), reached.get((cell.scene, cell.method))
        values.append(
            [
                *(cell.scene, cell.method, cell.runs, cell.failures, cell.unknown),
                *(cell.median, cell.low, cell.high, cell.seconds, target, seconds),
            ]
        )
        texts.append(
            [
                *(cell.scene, cell.method, str(cell.runs), str(cell.failures), str(cell.unknown)),
                *(shown(cell.median), *_interval(cell.low, cell.high), _seconds(cell.seconds), shown(target)),
                _seconds(seconds),
            ]
        )
    caption = f"By scene: {MEASURES[measure].label}. Bold: no other method has a better median."
    contested = {cell.scene for cell in cells if any(cell.scene == o.scene and cell.method != o.method for o in cells)}
    strong = [cell.best and cell.scene in contested for cell in cells]
    return Table(caption=caption, columns=columns, values=values, texts=texts, strong=strong)


def overall_table(lines: Sequence[Overall], measure: Measure, clock: Clock) -> Table:
    """A row per method."""
    columns = (
        Column("method", "method", marks=True),
        Column("scenes", "scenes"),
        Column("runs", "runs"),
        Column("failures", "failed"),
        Column("wins", "wins", marks=True),
        Column("mean", f"mean {MEASURES[measure].label}"),
        Column("low", "95 % interval", if_any=True),
        Column("high"),
        Column("seconds", CLOCKS[clock]),
    )
    values, texts = [], []
    for line in lines:
        counts = (line.scenes, line.runs, line.failures, line.wins)
        values.append([line.method, *counts, line.mean, line.low, line.high, line.seconds])
        texts.append(
            [line.method, *map(str, counts), shown(line.mean), *_interval(line.low, line.high), _seconds(line.seconds)]
        )
    most = max((line.wins for line in lines), default=0)
    return Table(
        caption="Over all scenes: mean of the medians. Wins: scenes on which no other method has a better median.",
        columns=columns,
        values=values,
        texts=texts,
        strong=[len(lines) > 1 and 0 < most == line.wins for line in lines],
    )


def runs_table(records: Sequence[RunRecord], measure: Measure, clock: Clock) -> Table:
    """A row per run, failures with their reasons."""
    columns = (
        Column("run", "run"),
        Column("scene", "scene"),
        Column("method", "method", marks=True),
        Column("seed", "seed"),
        Column("value", MEASURES[measure].label),
        Column("seconds", CLOCKS[clock]),
        Column("watertight", "watertight", if_any=True),
        Column("failure", "failure", if_any=True),
    )
    values, texts = [], []
    for record in records:
        value, seconds = record.result(measure), record.total_seconds(clock)
        closed = (record.certificate or {}).get("watertight")
        told = None if closed is None else "yes" if closed else "no"
        values.append([record.name, record.scene, record.method, record.seed, value, seconds, told, record.reason])
        seed = "-" if record.seed is None else str(record.seed)
        names = (record.name, record.scene, record.method, seed)
        texts.append([*names, shown(value), _seconds(seconds), told or "-", record.reason or ""])
    caption = "Every run. A run that failed, was stopped or has not ended has no result."
    return Table(caption=caption, columns=columns, values=values, texts=texts, strong=[False] * len(values))


def to_csv(table: Table) -> str:
    """Full precision; "inf" for failures, blank for what is not known."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([column.key for column in table.columns])
    writer.writerows([["" if value is None else value for value in row] for row in table.values])
    return out.getvalue()


def to_markdown(table: Table) -> str:
    """The caption and a table."""
    shown = for_people(table)
    lines = [table.caption, "", _markdown_row(shown.headings), "|" + "---|" * len(shown.headings)]
    for row, bold in zip(shown.rows, shown.bold, strict=True):
        cells = [cell.replace("|", "\\|") for cell in row]
        lines.append(
            _markdown_row([f"**{cell}**" if strong else cell for cell, strong in zip(cells, bold, strict=True)])
        )
    return "\n".join(lines) + "\n"


def to_latex(table: Table) -> str:
    """A ``table`` environment that needs no package; special characters are escaped."""
    shown = for_people(table)
    lines = ["\\begin{table}", "\\centering", f"\\caption{{{latex_text(table.caption)}}}"]
    lines += [f"\\begin{{tabular}}{{{'l' * len(shown.headings)}}}", "\\hline"]
    lines += [_latex_row(shown.headings, [False] * len(shown.headings)), "\\hline"]
    lines += [_latex_row(row, bold) for row, bold in zip(shown.rows, shown.bold, strict=True)]
    return "\n".join([*lines, "\\hline", "\\end{tabular}", "\\end{table}"]) + "\n"


def latex_text(text: str) -> str:
    """The text with LaTeX's special characters escaped."""
    special = {
        "\\": "\\textbackslash{}",
        "~": "\\textasciitilde{}",
        "^": "\\textasciicircum{}",
        "<": "\\textless{}",
        ">": "\\textgreater{}",
        "|": "\\textbar{}",
        **{character: f"\\{character}" for character in "&%$#_{}"},
    }
    return "".join(special.get(character, character) for character in text)


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A table without columns that are for programs or have nothing to say."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    bold: Sequence[Sequence[bool]]


def for_people(table: Table) -> Shown:
    kept = [
        (index, column)
        for index, column in enumerate(table.columns)
        if column.heading and not (column.if_any and all(row[index] in _NOTHING for row in table.texts))
    ]
    return Shown(
        headings=[column.heading for _, column in kept],
        rows=[[row[index] for index, _ in kept] for row in table.texts],
        bold=[[strong and column.marks for _, column in kept] for strong in table.strong],
    )


_NOTHING = ("", "-", "0")


def _interval(low: float | None, high: float | None) -> tuple[str, str]:
    if low is None or high is None:
        return "-", ""
    ends = [number(end) if math.isfinite(end) else "failed" for end in (low, high)]
    return f"{ends[0]} to {ends[1]}", ""


def _seconds(value: float | None) -> str:
    if value is None:
        return "-"
    return "never" if math.isinf(value) else f"{value:.3g}" if value < 100 else f"{value:.0f}"


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _latex_row(cells: Sequence[str], bold: Sequence[bool]) -> str:
    texts = [latex_text(cell) for cell in cells]
    marked = [f"\\textbf{{{text}}}" if strong else text for text, strong in zip(texts, bold, strict=True)]
    return " & ".join(marked) + " \\\\"
