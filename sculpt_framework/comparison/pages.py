"""A comparison on disk: one page, the diagrams and the tables, in a folder."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from sculpt_framework.comparison import tables
from sculpt_framework.comparison.diagrams import error_over_time, time_to_error
from sculpt_framework.comparison.runs import Clock, Measure, RunRecord
from sculpt_framework.comparison.statistics import (
    common_target,
    grouped,
    median_time_to_reach,
    overall,
    summarize,
)
from sculpt_framework.comparison.wording import CLOCKS, MEASURES
from sculpt_framework.errors import DataError, OutputError
from sculpt_framework.evaluation.drawing import Drawing, to_svg
from sculpt_framework.evaluation.drawing_png import to_png
from sculpt_framework.evaluation.web_page import bullets, grid_table, page
from sculpt_framework.export.atomic import write_atomically

READING = (
    "Thick lines are medians over seeds, thin lines single runs; a cross is where a run failed; a dot is a mesh of "
    "which only the end is known, a dashed line one whose time is not known.",
    "A run that failed, was stopped, was killed or has not ended counts as infinitely bad in medians and wins.",
    "Curves are measured at few points; between two of them time and error are interpolated on logarithmic scales.",
    "The target of a scene is the best result that half of the runs of every method reach; methods half of whose runs "
    "failed are left aside.",
    "Intervals: 95 % of the medians of as many seeds drawn again from these, from three seeds on. They tell about "
    "seeds, not about other scenes.",
    "Training time leaves out evaluation, saving, viewing and compiling. Times on different machines, or on a machine "
    "that does other things too, cannot be compared.",
)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Everything that is shown, before it is written."""

    records: Sequence[RunRecord]
    measure: Measure
    clock: Clock
    over_time: Drawing | None
    to_reach: Drawing | None
    results: tables.Table
    overall: tables.Table
    runs: tables.Table
    caveats: Sequence[str]
    """Why these runs may not be comparable, one line each."""


def compare(
    records: Sequence[RunRecord], *, measure: Measure | None = None, clock: Clock = "train", target: float | None = None
) -> Comparison:
    """Set records beside each other.

    ``measure``: Chamfer distance where any run knows it, else PSNR. ``target``: the value whose time is told; else
    one per scene, ``common_target``. Raises DataError where no record knows the measure.
    """
    chosen = measure or ("chamfer" if _known(records, "chamfer") else "psnr")
    if not _known(records, chosen):
        raise DataError(
            f"no run knows its {MEASURES[chosen].name}; choose another --measure, or look at each run's report."
        )
    cells = summarize(records, chosen, clock)
    by_scene = grouped(records, lambda record: record.scene)
    targets = {scene: common_target(group, chosen) if target is None else target for scene, group in by_scene.items()}
    reached = {
        (cell.scene, cell.method): _reached(by_scene[cell.scene], cell.method, targets[cell.scene], chosen, clock)
        for cell in cells
    }
    return Comparison(
        records=records,
        measure=chosen,
        clock=clock,
        over_time=error_over_time(records, chosen, clock),
        to_reach=time_to_error(records, chosen, clock),
        results=tables.results_table(cells, targets, reached, chosen, clock),
        overall=tables.overall_table(overall(records, chosen, clock), chosen, clock),
        runs=tables.runs_table(records, chosen, clock),
        caveats=caveats(records),
    )


def write_comparison(comparison: Comparison, folder: Path, title: str) -> list[Path]:
    """Write report.html, results.csv, overall.csv, runs.csv, tables.md, tables.tex and each diagram as SVG and PNG.

    Returns the paths. Files of an older comparison in the folder are replaced. Raises OutputError where that fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}.") from error
    shown = (comparison.overall, comparison.results, comparison.runs)
    files = {
        "report.html": html(comparison, title).encode(),
        "results.csv": tables.to_csv(comparison.results).encode(),
        "overall.csv": tables.to_csv(comparison.overall).encode(),
        "runs.csv": tables.to_csv(comparison.runs).encode(),
        "tables.md": "\n".join(map(tables.to_markdown, shown)).encode(),
        "tables.tex": "\n".join(map(tables.to_latex, shown)).encode(),
    }
    for name, drawing in (("error_over_time", comparison.over_time), ("time_to_error", comparison.to_reach)):
        if drawing is not None:
            files |= {f"{name}.svg": to_svg(drawing).encode(), f"{name}.png": to_png(drawing)}
    for name, content in files.items():
        write_atomically(folder / name, content)
    return [folder / name for name in files]


def html(comparison: Comparison, title: str) -> str:
    """The comparison as one page that loads nothing."""
    none = '<p class="unknown">No run has a curve of it.</p>'

    def drawn(drawing: Drawing | None) -> str:
        width = f"max-width: {drawing.width:.0f}px" if drawing else ""
        return f'<div style="{width}">{to_svg(drawing)}</div>' if drawing else none

    what = f"{len(comparison.records)} runs; {MEASURES[comparison.measure].label}; {CLOCKS[comparison.clock]}"
    sections = [
        ("", f"<p>{what}</p>"),
        ("Over all scenes", _table(comparison.overall)),
        ("Error against time", drawn(comparison.over_time)),
        ("Time to reach an error", drawn(comparison.to_reach)),
        ("By scene", _table(comparison.results)),
        ("Before comparing", bullets(comparison.caveats) or "<p>Same inputs, same device, same versions.</p>"),
        ("Every run", _table(comparison.runs)),
        ("How to read this", bullets(READING)),
    ]
    return page(title, sections)


def caveats(records: Sequence[RunRecord]) -> list[str]:
    """What differs between runs that are compared, and failures, one line each."""
    out = []
    failed = [record for record in records if record.failed]
    if failed:
        told = "; ".join(f"{record.name} ({record.method}, {record.scene}): {record.reason}" for record in failed)
        out.append(f"{len(failed)} of {len(records)} have no result: {told}")
    for scene, group in grouped([r for r in records if r.inputs], lambda record: record.scene).items():
        kinds = dict.fromkeys(kind for record in group for kind in record.inputs)
        differing = [kind for kind in kinds if len({record.inputs.get(kind) for record in group}) > 1]
        if differing:
            out.append(f"runs of {scene} did not read the same: {', '.join(differing)} differ")
    ours = [record for record in records if record.folder is not None]
    for what, values in (
        ("devices", {str(record.device) for record in ours}),
        ("thread counts", {str(record.config.get("threads")) for record in ours}),
        *((name, {str(r.versions.get(name)) for r in ours}) for name in _names_of_versions(ours)),
    ):
        if len(values) > 1:
            out.append(f"different {what}: {', '.join(sorted(values))}")
    if any(record.folder is None for record in records):
        out.append("times of external meshes are as their makers give them, from whatever machine that was")
    return out


def _reached(
    group: Sequence[RunRecord], method: str, target: float | None, measure: Measure, clock: Clock
) -> float | None:
    if target is None:
        return None
    return median_time_to_reach([record for record in group if record.method == method], target, measure, clock)


def _known(records: Sequence[RunRecord], measure: Measure) -> bool:
    values = (record.result(measure) for record in records)
    curves = (point.value(measure) for record in records for point in record.curve)
    return any(value is not None and math.isfinite(value) for value in (*values, *curves))


def _names_of_versions(records: Sequence[RunRecord]) -> Mapping[str, None]:
    return dict.fromkeys(name for record in records for name in record.versions)


def _table(table: tables.Table) -> str:
    shown = tables.for_people(table)
    return f"<p>{escape(table.caption)}</p>{grid_table(shown.headings, shown.rows, shown.bold)}"
