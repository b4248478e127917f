"""The table of captures: a row per capture and method, one for each mesh that another program made, and a page."""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sculpt_framework.comparison.pages import caveats
from sculpt_framework.comparison.runs import RunRecord
from sculpt_framework.comparison.statistics import grouped, median
from sculpt_framework.evaluation.web_page import bullets, grid_table, page
from sculpt_framework.experiments.capture_measures import Measured, measured_external, measured_run
from sculpt_framework.experiments.matrix import Cell
from sculpt_framework.experiments.results import CellResult, records
from sculpt_framework.experiments.suite_page import curves
from sculpt_framework.experiments.suites import Suite
from sculpt_framework.experiments.tables import UNKNOWN, Table, number
from sculpt_framework.posed_images.masks import has_mask_files

MEASURED = (
    "radius",
    "distance",
    "distance_median",
    "normal_error",
    "accuracy",
    "completeness",
    "seen_share",
    "distance_well_seen",
    "distance_median_well_seen",
    "normal_error_well_seen",
    "accuracy_well_seen",
    "completeness_well_seen",
    "seen_share_well_seen",
    "residual_px",
    "residual_p90_px",
    "residual_depth",
    "residual_depth_p90",
    "depth_error",
    "judged",
    "pairs",
    "roughness",
    "plain_roughness",
    "plain",
    "watertight",
    "faces",
)
"""Columns of results.csv that every mesh has."""
_OF_RUNS = ("psnr", "psnr_fitted", "t_wall_s", "rss_mb")
"""And those that only a run can tell."""
_HEADINGS = (
    "capture",
    "mesh",
    "distance, 1e-2 radius",
    "well seen",
    "its median",
    "normals °",
    "distance",
    "residual px",
    "90 % px",
    "depth, 1e-2 radius",
    "judged %",
    "roughness °",
    "plain °",
    "PSNR dB",
    "fitted dB",
    "seconds",
    "MiB",
    "watertight",
    "runs",
)


@dataclass(frozen=True, kw_only=True)
class Line:
    """A mesh of a capture: of a run, or of another program."""

    capture: str
    """Label of the scene."""
    name: str
    seed: int | None
    values: Mapping[str, Any]
    """By the names of ``MEASURED`` and ``_OF_RUNS``; what is missing is not known."""
    failed: bool
    reason: str | None


def lines(results: Sequence[CellResult], suite: Suite, against: Sequence[str], folder: Path) -> list[Line]:
    """What there is, capture by capture, runs before the meshes of others."""
    out = []
    for data, scenes in grouped(suite.scenes, lambda scene: scene.data).items():
        labels = [scene.label for scene in scenes]
        out += [
            _of_run(each.cell, each.record, measured_run(folder, each.cell, data))
            for each in results
            if each.cell.scene in labels and each.record is not None
        ]
        for name in against:
            if (found := measured_external(folder, data, name)) is not None:
                out.append(_of_external(labels[0], _called(name, against), found))
    return out


def capture_tables(
    results: Sequence[CellResult], suite: Suite, against: Sequence[str], folder: Path
) -> tuple[list[Table], list[str], str]:
    """The table, the notes below it, and the text of results.csv."""
    found = lines(results, suite, against, folder)
    return [capture_table(found)], capture_notes(suite), captures_csv(found)


def capture_table(found: Sequence[Line]) -> Table:
    """Medians over seeds; a failure is infinitely bad in them."""
    rows = [
        _row(capture, name, same)
        for capture, group in grouped(found, lambda line: line.capture).items()
        for name, same in grouped(group, lambda line: line.name).items()
    ]
    return Table(title="Captures", columns=_HEADINGS, rows=tuple(rows))


def capture_notes(suite: Suite) -> list[str]:
    """What a reader of the table must know, a line each."""
    out = [
        "distance: mean of both directions over what of the truth any camera sees; well seen, its median, normals: "
        "over what three see, 1e-2 radius and mean angle. radius: half of the longest side of the truth's bounding "
        "box, without truth of the capture's box.",
        "residual, depth and roughness: of all pairs of photographs, the same for all meshes of a capture, with its "
        "own masks where it has some. Compare where about the same share is judged.",
        "PSNR: of the views each run held out for itself, without and after fitting one gain and offset per image and "
        "channel. seconds: wall, start and saving included. Medians over seeds count a failure as a failure.",
        f"{UNKNOWN}: not known. Figures are kept in measures/; a mesh that has changed is measured again.",
    ]
    bare = [path.name for data in dict.fromkeys(s.data for s in suite.scenes) if not has_mask_files(path := Path(data))]
    if bare:
        out.append(f"without masks in files, taken as they are: {', '.join(bare)}.")
    if suite.left_out:
        out.append(f"folders that are no captures: {', '.join(suite.left_out)}.")
    return out


def captures_csv(found: Sequence[Line]) -> str:
    """A line per mesh; lengths in scene units. Blank: not known."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["capture", "mesh", "seed", "status", *MEASURED, *_OF_RUNS, "error"])
    for line in found:
        cells = [_csv_cell(line.values.get(name)) for name in (*MEASURED, *_OF_RUNS)]
        seed = "" if line.seed is None else line.seed
        status = "failed" if line.failed else "finished"
        writer.writerow([line.capture, line.name, seed, status, *cells, line.reason or ""])
    return out.getvalue()


def capture_page(results: Sequence[CellResult], suite: Suite, against: Sequence[str], folder: Path) -> str:
    """The table and the curves of the runs on one page that loads nothing."""
    found = lines(results, suite, against, folder)
    table = capture_table(found)
    ran = [record for scene in suite.scenes for record in records(results, scene=scene.label)]
    shown = [*ran, *_levels(found, suite)]
    sections = [
        ("", grid_table(table.columns, table.rows)),
        ("Distance to the truth against time", curves(shown, "chamfer")),
        ("Residual between photographs against time", curves(shown, "residual_px")),
        ("Before comparing", bullets(caveats(ran))),
        ("How to read this", bullets([*capture_notes(suite), *_READING])),
    ]
    return page("Suite captures", [(name, content) for name, content in sections if content])


_READING = (
    "Curves are what runs measure of themselves: the distance over all of the truth, also what is not seen, or the "
    "residual of 12 pairs of small images. Dashed: another program's mesh, measured the same way; of captures run "
    "without their masks, with the masks.",
)


def _of_run(cell: Cell, record: RunRecord, kept: Measured) -> Line:
    if record.failed:
        return Line(capture=cell.scene, name=cell.setting, seed=cell.seed, values={}, failed=True, reason=record.reason)
    own = {"t_wall_s": record.total_seconds("wall")}
    own |= {name: record.final.get(name) for name in ("psnr", "psnr_fitted", "rss_mb")}
    return Line(
        capture=cell.scene,
        name=cell.setting,
        seed=cell.seed,
        values={**kept.values, **own},
        failed=False,
        reason=None if kept.error is None else f"not measured: {kept.error}",
    )


def _called(name: str, against: Sequence[str]) -> str:
    """A file without its ending, unless another differs from it in that alone."""
    stem = Path(name).stem
    return stem if [Path(each).stem for each in dict.fromkeys(against)].count(stem) == 1 else name


def _of_external(capture: str, name: str, found: Measured) -> Line:
    return Line(
        capture=capture,
        name=name,
        seed=None,
        values=found.values,
        failed=False,
        reason=None if found.error is None else f"not measured: {found.error}",
    )


def _row(capture: str, name: str, same: Sequence[Line]) -> tuple[str, ...]:
    def middle(value: str, digits: int, *, times: float = 1.0, per_radius: bool = False) -> str:
        known = [_value(line, value, per_radius) for line in same]
        return number(median([each for each in known if each is not None]), digits, times=times)

    closed = [line.values["watertight"] for line in same if "watertight" in line.values]
    failed = sum(line.failed for line in same)
    reasons = list(dict.fromkeys(line.reason for line in same if line.reason))
    told = [*([f"{failed} failed"] if failed else []), *reasons]
    return (
        capture,
        name,
        middle("distance", 3, times=100.0, per_radius=True),
        middle("distance_well_seen", 3, times=100.0, per_radius=True),
        middle("distance_median_well_seen", 3, times=100.0, per_radius=True),
        middle("normal_error_well_seen", 1),
        _significant(median([v for line in same if (v := _value(line, "distance", False)) is not None])),
        middle("residual_px", 3),
        middle("residual_p90_px", 3),
        middle("residual_depth", 3, times=100.0, per_radius=True),
        middle("judged", 0, times=100.0),
        middle("roughness", 2),
        middle("plain_roughness", 2),
        middle("psnr", 2),
        middle("psnr_fitted", 2),
        middle("t_wall_s", 0),
        middle("rss_mb", 0),
        _share(closed),
        "; ".join([str(sum(line.seed is not None for line in same) or UNKNOWN), *told]),
    )


def _value(line: Line, name: str, per_radius: bool) -> float | None:
    if line.failed:
        return math.inf
    value = line.values.get(name)
    return None if value is None else value / line.values["radius"] if per_radius else float(value)


def _significant(value: float | None) -> str:
    return number(value, 0) if value is None or not math.isfinite(value) else f"{value:.4g}"


def _share(flags: Sequence[bool]) -> str:
    if not flags:
        return UNKNOWN
    return "yes" if all(flags) else "no" if not any(flags) else f"{sum(flags)} of {len(flags)}"


def _levels(found: Sequence[Line], suite: Suite) -> Iterator[RunRecord]:
    """Meshes of others, for every label of their capture, as runs of which only the end is known."""
    data_of = {scene.label: scene.data for scene in suite.scenes}
    for line in found:
        if line.seed is None and line.values:
            final = {"chamfer_ps": line.values.get("chamfer_ps"), "residual_px": line.values["curve_residual_px"]}
            for label, data in data_of.items():
                if data == data_of[line.capture]:
                    yield RunRecord(name=line.name, scene=label, method=line.name, final=final)


def _csv_cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
