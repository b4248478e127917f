"""``report.html``: one page, complete in itself, of what a run did and what came out."""

import itertools
import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.charts import Axis, Series, histogram_chart, line_chart, number
from sculpt_framework.evaluation.curve import CURVE_COLUMNS, CurveRow, read_curve
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.evaluation.mesh_report import RESULT_MEASURES
from sculpt_framework.evaluation.pictures import Picture, png_data_uri
from sculpt_framework.evaluation.triangle_quality import triangle_quality
from sculpt_framework.evaluation.web_page import bullets, details, fact, facts_table, grid_table, page
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.plan.savings import savings

TIME = Axis(label="training time, s (logarithmic)", log=True)
Facts = Mapping[str, Any]


def write_report(run_dir: Path, pictures: Mapping[str, Mapping[str, Picture]]) -> Path:
    """Write RUN_DIR/report.html from what the run left there, and return its path.

    Reads curve.csv, metrics.json, config.json, events.jsonl and mesh.ply; a section whose file is missing says so.
    plan.json is read too, and its section left out where there is none. ``pictures`` are shown in their order, in rows
    under their headings. Raises DataError where a file is there but broken, and OutputError where the page cannot be
    written.
    """
    metrics, config = _read_json(run_dir / "metrics.json"), _read_json(run_dir / "config.json")
    events = _read_events(run_dir / "events.jsonl")
    curve = read_curve(run_dir / "curve.csv") if (run_dir / "curve.csv").exists() else []
    started = next((event["data"] for event in reversed(events) if event["event"] == "run_started"), {})
    title = f"{metrics.get('scene') or started.get('scene') or run_dir.name} · {metrics.get('method') or 'run'}"
    final = metrics.get("final") or {}
    sections = [
        ("", _summary(metrics) + _unknown(metrics, started)),
        ("Error against time", _curves(curve)),
        ("At shares of the run", _milestones(metrics.get("milestones") or ())),
        ("Where the time went", facts_table(_time_spent(events))),
        ("Pictures", _pictures(pictures)),
        ("Triangles", _triangles(run_dir / "mesh.ply")),
        ("Mesh certificate", facts_table(metrics.get("certificate") or {})),
        ("Input", _input(started)),
        *_plan(run_dir / "plan.json", events),
        ("Decisions", bullets(_decisions(events))),
        ("Measures at the end", _measures(final)),
        (
            "Made with",
            facts_table({"device": started.get("device"), "seed": metrics.get("seed"), **_versions(metrics)}),
        ),
        ("Configuration", details("config.json", config)),
    ]
    path = run_dir / "report.html"
    write_atomically(path, page(title, sections).encode("utf-8"))
    return path


def _summary(metrics: Facts) -> str:
    """The figures one looks for first."""
    final, certificate = metrics.get("final") or {}, metrics.get("certificate") or {}
    tiles = [("status", metrics.get("status"))]
    styles = {
        "chamfer_ps": ("Chamfer distance, scene units", "{:.3g}"),
        "residual_px": ("residual between neighbouring views", "{:.2f} px"),
        "psnr": ("PSNR, held-out views", "{:.2f} dB"),
        "iou": ("mask IoU", "{:.4f}"),
        "faces": ("faces", "{:.0f}"),
        "t_train_s": ("training", "{:.0f} s"),
        "t_wall_s": ("from start to end", "{:.0f} s"),
    }
    for key, (label, style) in styles.items():
        value = final.get(key)
        if key == "residual_px" and value is None:
            continue  # With a reference a run is not held against its photographs.
        tiles.append((label, "not known" if value is None else style.format(value)))
    if certificate:
        closed = certificate["watertight"] and certificate.get("watertight_merged", True)
        tiles.append(("watertight", fact(closed)))
    return (
        '<div class="tiles">'
        + "".join(f"<div><b>{escape(fact(value))}</b><span>{escape(label)}</span></div>" for label, value in tiles)
        + "</div>"
    )


def _unknown(metrics: Facts, started: Facts) -> str:
    """What this run cannot tell, in words; nothing where it has a reference."""
    if not metrics or (metrics.get("final") or {}).get("chamfer_ps") is not None or started.get("reference"):
        return ""
    return (
        '<p class="unknown">There is no reference mesh: how far the surface is from the true one is not known, nor are'
        " F-score, normal consistency and the colours of mesh error. The residual says how well the mesh brings"
        " neighbouring photographs onto each other, where they have texture. PSNR, SSIM and mask IoU are of held-out"
        " views; they say nothing about what no view shows.</p>"
    )


def seconds_spent(events: Sequence[Facts]) -> dict[str, float]:
    """Wall seconds of the process by what they went to, up to the end of the run; of its last process if resumed.

    Empty if the events do not begin with a start. "measuring" has the measurement of the result in it.
    """
    first = max((index for index, event in enumerate(events) if event["event"] == "run_started"), default=None)
    if first is None or "t_train" not in events[first]:
        return {}
    names = {"evaluation": "measuring", "run_ended": "measuring", "checkpoint": "saving checkpoints"}
    rest = "compiling, pictures, viewing, writing"
    start, last = events[first], events[-1]
    idle: dict[str, float] = {"measuring": 0.0, "saving checkpoints": 0.0, rest: 0.0}
    for before, after in itertools.pairwise(events[first:]):
        # What passed on the wall and not on the training clock belongs to the event it led to.
        seconds = (after["t_wall"] - before["t_wall"]) - (after["t_train"] - before["t_train"])
        own = seconds
        if after["event"] == "evaluation":
            # Before it, files may have been written and kernels compiled.
            own = min(seconds, after["data"].get("seconds", seconds))
        idle[names.get(after["event"], rest)] += max(0.0, own)
        idle[rest] += max(0.0, seconds - own)
    return {"start and loading": start["t_wall"], "training": last["t_train"] - start["t_train"], **idle}


def _time_spent(events: Sequence[Facts]) -> Facts:
    parts = seconds_spent(events)
    total = max(sum(parts.values()), 1e-9)
    return {name: f"{seconds:.1f} s, {100 * seconds / total:.0f} %" for name, seconds in parts.items()}


def _input(started: Facts) -> str:
    """What was unusual about the data, and the digests that say which data they were."""
    notes = bullets([*map(str, started.get("notes", ()))]) or "<p>Nothing unusual.</p>"
    digests = {f"SHA-256 of {name}": digest for name, digest in (started.get("inputs") or {}).items()}
    return notes + facts_table(digests)


def _plan(path: Path, events: Sequence[Facts]) -> list[tuple[str, str]]:
    """What the run left out or chose for this scene, how to have it otherwise, and what that saved; empty without."""
    if not path.exists():
        return []
    keys = ("item", "value", "evidence", "saves", "override")
    plan = _read_json(path)
    tables = {}
    for part in ("decisions", "kept"):
        chosen = plan.get(part) or ()
        tables[part] = grid_table(
            keys, [["" if decision.get(key) is None else fact(decision[key]) for key in keys] for decision in chosen]
        )
    kept = f"<details><summary>looked at and kept</summary>{tables['kept']}</details>" if tables["kept"] else ""
    sections = [("Plan", tables["decisions"] + kept)]
    saved = savings(plan, events)
    if saved:
        rows = [[each.item, each.what, _measured(each.seconds), _measured(each.megabytes)] for each in saved]
        note = (
            "<p>Seconds are what this run's own inner steps took, times those it left out; not measured where it"
            " never did such a thing. What it changed: <code>sculpt-ablate --plan</code>.</p>"
        )
        table = grid_table(("item", "left out", "seconds", "megabytes"), rows)
        sections.append(("What this scene did not need", table + note))
    return sections


def _measured(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.1f}"


def _curves(curve: Sequence[CurveRow]) -> str:
    """A chart per quantity that is known, and below them which are not; scores between 0 and 1 share one."""
    charts = [
        ("Chamfer distance to the reference", {"chamfer_ps": "Chamfer"}, Axis(label="scene units (log)", log=True)),
        (
            "Displacement between neighbouring views",
            {"residual_px": "median", "residual_p90_px": "90th percentile"},
            Axis(label="pixels (log)", log=True),
        ),
        ("Roughness of what is seen", {"roughness": "all", "plain_roughness": "plain places"}, Axis(label="degrees")),
        ("PSNR on held-out views", {"psnr": "PSNR", "psnr_fitted": "light fitted"}, Axis(label="dB")),
        (
            "Scores, 1 is best",
            {"fscore": "F-score", "normal_consistency": "normals", "ssim": "SSIM", "iou": "mask IoU"},
            Axis(label="score"),
        ),
        ("Triangles under 10 degrees", {"under10_pct": "share"}, Axis(label="% of triangles")),
        ("Size of the mesh", {"faces": "faces"}, Axis(label="triangles")),
        ("Peak memory", {"rss_mb": "memory"}, Axis(label="MiB")),
    ]
    parts, unknown = [], []
    for title, columns, axis in charts:
        series = [Series(name=name, points=_points(curve, column)) for column, name in columns.items()]
        if any(x > 0 and (y > 0 or not axis.log) for line in series for x, y in line.points):
            parts.append(line_chart(title, series, TIME, axis))
        else:
            unknown.append(title)
    missing = f'<p class="unknown">Not known for this run: {escape("; ".join(unknown))}.</p>' if unknown else ""
    return f'<div class="charts">{"".join(parts)}</div>{missing}{_rows(curve)}' if curve else ""


def _rows(curve: Sequence[CurveRow]) -> str:
    """The numbers behind the curves, to be unfolded."""
    columns = [column for column in CURVE_COLUMNS if any(row[column] is not None for row in curve)]
    rows = [["" if row[column] is None else number(row[column] or 0.0) for column in columns] for row in curve]
    return f"<details><summary>curve.csv</summary>{grid_table(columns, rows)}</details>"


def _points(curve: Sequence[CurveRow], column: str) -> list[tuple[float, float]]:
    pairs = [(row["t_train_s"], row[column]) for row in curve]
    return [(x, y) for x, y in pairs if x is not None and y is not None]


def _milestones(milestones: Sequence[Facts]) -> str:
    labels = {"chamfer_ps": "Chamfer", "psnr": "PSNR, dB", "iou": "mask IoU"}
    shown = {key: label for key, label in labels.items() if any(row.get(key) is not None for row in milestones)}
    if not milestones or not shown:
        return ""
    rows = [
        [f"{100 * row['share']:.0f} %", *("not known" if row.get(key) is None else f"{row[key]:.4g}" for key in shown)]
        for row in milestones
    ]
    return grid_table(["share of the run", *shown.values()], rows)


def _pictures(pictures: Mapping[str, Mapping[str, Picture]]) -> str:
    out = []
    for heading, row in pictures.items():
        figures = [
            f'<figure><img src="{png_data_uri(picture)}" alt="{escape(name)}">'
            f"<figcaption>{escape(name)}</figcaption></figure>"
            for name, picture in row.items()
        ]
        out.append(f'<h3>{escape(heading)}</h3><div class="pictures">{"".join(figures)}</div>')
    return "".join(out)


def _triangles(path: Path) -> str:
    if not path.exists():
        return ""
    try:
        quality = triangle_quality(load_mesh(path))
    except DataError:
        return "<p>The mesh has no triangles.</p>"
    share = Axis(label="% of triangles")
    charts = [
        histogram_chart("Smallest angle", quality.minimum_angles, Axis(label="degrees"), share),
        histogram_chart("Largest angle", quality.maximum_angles, Axis(label="degrees"), share),
        histogram_chart("Aspect ratio", quality.aspect_ratios, Axis(label="ratio, 1 is equilateral"), share),
        histogram_chart("Radius ratio", quality.radius_ratios, Axis(label="ratio, 1 is equilateral"), share),
    ]
    facts = {
        "smallest angle of all": f"{quality.smallest_angle:.3g} degrees",
        "largest angle of all": f"{quality.largest_angle:.4g} degrees",
        "mean smallest angle": f"{quality.mean_minimum_angle:.1f} degrees",
        "mean largest angle": f"{quality.mean_maximum_angle:.1f} degrees",
        "mean aspect ratio": quality.mean_aspect_ratio,
        "mean radius ratio": quality.mean_radius_ratio,
        "angle under 10 degrees": f"{quality.under10_pct:.2f} % of triangles",
        "aspect ratio above 4": f"{quality.aspect_over4_pct:.2f} % of triangles",
        "radius ratio above 4": f"{quality.radius_over4_pct:.2f} % of triangles",
    }
    return f'<div class="charts">{"".join(charts)}</div>{facts_table(facts)}'


def _measures(final: Facts) -> str:
    rows, notes = [], {**RESULT_MEASURES, **CURVE_COLUMNS}
    for name, value in final.items():
        # A score per threshold is a row of its own.
        parts = {f"{name} {at}": each for at, each in value.items()} if isinstance(value, Mapping) else {name: value}
        rows += [[part, fact(each), notes.get(part, "")] for part, each in parts.items()]
    return grid_table(["measure", "value", "what it is"], rows)


def _versions(metrics: Facts) -> Facts:
    return {name: version for name, version in (metrics.get("versions") or {}).items() if version is not None}


def _decisions(events: Sequence[Facts]) -> list[str]:
    told = [event["data"] for event in events if event["event"] in ("decision", "action", "warning", "recovered")]
    return ["; ".join(f"{key.replace('_', ' ')}: {fact(value)}" for key, value in data.items()) for data in told]


def _read_json(path: Path) -> Facts:
    """The object in a JSON file, empty where there is no such file."""
    if not path.exists():
        return {}
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DataError(f"{path} is not valid JSON ({error}); it should be as the run wrote it") from error


def _read_events(path: Path) -> list[Facts]:
    """Events of a run; a line that was cut when a run was killed is passed over."""
    events = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            events.append(json.loads(line))
        except ValueError:
            continue
    return events
