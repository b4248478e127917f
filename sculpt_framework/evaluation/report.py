"""``report.html``: one page, complete in itself, of what a run did and what came out."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.charts import Axis, Series, histogram_chart, line_chart, number
from sculpt_framework.evaluation.curve import CURVE_COLUMNS, CurveRow, read_curve
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.evaluation.pictures import Picture, png_data_uri
from sculpt_framework.evaluation.triangle_quality import triangle_quality
from sculpt_framework.export.atomic import write_atomically

TIME = Axis(label="training time, s (logarithmic)", log=True)
Facts = Mapping[str, Any]


def write_report(run_dir: Path, pictures: Mapping[str, Picture]) -> Path:
    """Write RUN_DIR/report.html from what the run left there, and return its path.

    Reads curve.csv, metrics.json, config.json, events.jsonl and mesh.ply; a section whose file is missing says so.
    ``pictures`` are shown in their order under their names. Raises DataError where a file is there but broken, and
    OutputError where the page cannot be written.
    """
    metrics, config = _read_json(run_dir / "metrics.json"), _read_json(run_dir / "config.json")
    events = _read_events(run_dir / "events.jsonl")
    curve = read_curve(run_dir / "curve.csv") if (run_dir / "curve.csv").exists() else []
    started = next((event["data"] for event in reversed(events) if event["event"] == "run_started"), {})
    title = f"{metrics.get('scene') or started.get('scene') or run_dir.name} · {metrics.get('method') or 'run'}"
    sections = [
        ("", _summary(metrics)),
        ("Error against time", _curves(curve)),
        ("At shares of the run", _milestones(metrics.get("milestones") or ())),
        ("Pictures", _pictures(pictures)),
        ("Triangles", _triangles(run_dir / "mesh.ply")),
        ("Mesh certificate", _table(metrics.get("certificate") or {})),
        ("Input", _list([*map(str, started.get("notes", ()))]) or "<p>Nothing unusual.</p>"),
        ("Decisions", _list(_decisions(events))),
        ("Measures at the end", _measures(metrics.get("final") or {})),
        ("Made with", _table({"device": started.get("device"), "seed": metrics.get("seed"), **_versions(metrics)})),
        ("Configuration", f"<details><summary>config.json</summary><pre>{_pretty(config)}</pre></details>"),
    ]
    body = "".join(
        f"<section>{f'<h2>{escape(name)}</h2>' if name else ''}{content or _UNKNOWN}</section>"
        for name, content in sections
    )
    path = run_dir / "report.html"
    write_atomically(path, _page(title, body).encode("utf-8"))
    return path


def _summary(metrics: Facts) -> str:
    """The figures one looks for first."""
    final, certificate = metrics.get("final") or {}, metrics.get("certificate") or {}
    tiles = [("status", metrics.get("status"))]
    styles = {
        "chamfer_ps": ("Chamfer, point to surface", "{:.3g}"),
        "psnr": ("PSNR, held-out views", "{:.2f} dB"),
        "iou": ("mask IoU", "{:.4f}"),
        "faces": ("faces", "{:.0f}"),
        "t_train_s": ("training", "{:.0f} s"),
        "t_wall_s": ("from start to end", "{:.0f} s"),
    }
    for key, (label, style) in styles.items():
        value = final.get(key)
        tiles.append((label, "not known" if value is None else style.format(value)))
    if certificate:
        tiles.append(("watertight", _fact(certificate["watertight"])))
    return (
        '<div class="tiles">'
        + "".join(f"<div><b>{escape(_fact(value))}</b><span>{escape(label)}</span></div>" for label, value in tiles)
        + "</div>"
    )


def _curves(curve: Sequence[CurveRow]) -> str:
    """A chart per quantity that is known; scores between 0 and 1 share one."""
    charts = [
        ("Chamfer distance to the reference", {"chamfer_ps": "Chamfer"}, Axis(label="scene units (log)", log=True)),
        ("PSNR on held-out views", {"psnr": "PSNR"}, Axis(label="dB")),
        (
            "Scores, 1 is best",
            {"fscore": "F-score", "normal_consistency": "normals", "ssim": "SSIM", "iou": "mask IoU"},
            Axis(label="score"),
        ),
        ("Triangles under 10 degrees", {"under10_pct": "share"}, Axis(label="% of triangles")),
        ("Size of the mesh", {"faces": "faces"}, Axis(label="triangles")),
        ("Peak memory", {"rss_mb": "memory"}, Axis(label="MiB")),
    ]
    parts = []
    for title, columns, axis in charts:
        series = [Series(name=name, points=_points(curve, column)) for column, name in columns.items()]
        if any(x > 0 and (y > 0 or not axis.log) for line in series for x, y in line.points):
            parts.append(line_chart(title, series, TIME, axis))
        else:
            parts.append(f'<p class="unknown">{escape(title)}: not known for this run.</p>')
    return f'<div class="charts">{"".join(parts)}</div>' if curve else ""


def _points(curve: Sequence[CurveRow], column: str) -> list[tuple[float, float]]:
    pairs = [(row["t_train_s"], row[column]) for row in curve]
    return [(x, y) for x, y in pairs if x is not None and y is not None]


def _milestones(milestones: Sequence[Facts]) -> str:
    labels = {"chamfer_ps": "Chamfer", "psnr": "PSNR, dB", "iou": "mask IoU"}
    shown = {key: label for key, label in labels.items() if any(row.get(key) is not None for row in milestones)}
    if not milestones or not shown:
        return ""
    head = "".join(f"<th>{label}</th>" for label in ("share of the run", *shown.values()))
    rows = [
        f"<td>{100 * row['share']:.0f} %</td>"
        + "".join(f"<td>{'' if row.get(key) is None else f'{row[key]:.4g}'}</td>" for key in shown)
        for row in milestones
    ]
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def _pictures(pictures: Mapping[str, Picture]) -> str:
    figures = [
        f'<figure><img src="{png_data_uri(picture)}" alt="{escape(name)}">'
        f"<figcaption>{escape(name)}</figcaption></figure>"
        for name, picture in pictures.items()
    ]
    return f'<div class="pictures">{"".join(figures)}</div>' if figures else ""


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
    return f'<div class="charts">{"".join(charts)}</div>{_table(facts)}'


def _measures(final: Facts) -> str:
    rows = [
        f"<tr><th>{escape(name)}</th><td>{escape(_fact(value))}</td><td>{escape(CURVE_COLUMNS.get(name, ''))}</td></tr>"
        for name, value in final.items()
    ]
    return f"<table>{''.join(rows)}</table>" if rows else ""


def _versions(metrics: Facts) -> Facts:
    return {name: version for name, version in (metrics.get("versions") or {}).items() if version is not None}


def _decisions(events: Sequence[Facts]) -> list[str]:
    told = [event["data"] for event in events if event["event"] in ("decision", "action", "warning", "recovered")]
    return ["; ".join(f"{key.replace('_', ' ')}: {_fact(value)}" for key, value in data.items()) for data in told]


def _table(facts: Facts) -> str:
    rows = [
        f"<tr><th>{escape(str(name).replace('_', ' '))}</th><td>{escape(_fact(value))}</td></tr>"
        for name, value in facts.items()
    ]
    return f"<table>{''.join(rows)}</table>" if rows else ""


def _list(items: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>" if items else ""


def _fact(value: Any) -> str:
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else str(value)


def _pretty(config: Facts) -> str:
    return escape(json.dumps(config, indent=2))


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


_UNKNOWN = '<p class="unknown">Not recorded for this run.</p>'


def _page(title: str, body: str) -> str:
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{_STYLE}</style></head>
<body><h1>{escape(title)}</h1>{body}</body></html>
"""


_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; max-width: 1440px; margin: 2rem auto;
       padding: 0 1.5rem; }
h1 { font-size: 1.6rem; margin-bottom: 1rem; }
h2 { font-size: 1.15rem; border-bottom: 1px solid #ddd; padding-bottom: .3rem; margin-top: 2.2rem; }
.tiles { display: flex; flex-wrap: wrap; gap: .8rem; }
.tiles div { border: 1px solid #ddd; border-radius: 8px; padding: .6rem 1rem; min-width: 7.5rem; }
.tiles b { display: block; font-size: 1.25rem; }
.tiles span, .unknown, figcaption { color: #666; font-size: .9rem; }
.charts, .pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(400px, 1fr)); gap: 1rem 2rem; }
.pictures { grid-template-columns: repeat(auto-fill, minmax(240px, 1fr)); }
.pictures img { width: 100%; border: 1px solid #ddd; }
figure { margin: 0; }
table { border-collapse: collapse; }
th, td { text-align: left; padding: .2rem 1.2rem .2rem 0; border-bottom: 1px solid #eee; font-weight: 400; }
th { color: #555; }
pre { background: #f6f6f6; padding: 1rem; overflow-x: auto; font-size: .85rem; }
"""
