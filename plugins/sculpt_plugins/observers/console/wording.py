"""The words and numbers the console shows; pure functions from event data to lines of text."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

Data = Mapping[str, Any]

_FILES = {"mesh": "mesh", "glb": "", "gaussians": "Gaussians", "curve": "curve", "report": "report"}
"""Files named by the end of a run, with the label of their line."""


def duration(seconds: float | int) -> str:
    """42 s, 3:05, 1:02:03."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    hours, rest = divmod(whole, 3600)
    minutes, rest = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def count(number: float | int) -> str:
    """812, 24.1k, 1.3M."""
    if number < 1000:
        return f"{number:.0f}"
    return f"{number / 1e3:.1f}k" if number < 1e6 else f"{number / 1e6:.1f}M"


def memory(megabytes: float | int) -> str:
    return f"{megabytes:.0f} MB" if megabytes < 1000 else f"{megabytes / 1024:.1f} GB"


def start_lines(data: Data) -> list[str]:
    """What is about to be done, and a line for everything unusual in the input."""
    if data.get("max_time") is not None:
        extent = f"done within {duration(data['max_time'])}"
    elif data.get("total_steps") is not None:
        extent = f"{data['total_steps']} outer steps"
    else:
        extent = ""
    facts = [f"{data['scene']} with {data['method']}", f"{data['views']} views", extent]
    return [", ".join(filter(None, facts)), *(f"note: {note}" for note in data["notes"])]


def stage_text(data: Data) -> str:
    parts = [f"stage {data['index'] + 1}/{data['count']}", f"grid {grid_text(data['grid'])}"]
    parts.append(f"images at {100 * data['image_scale']:.0f} %")
    if data["silhouette_only"]:
        parts.append("silhouettes only")
    return ", ".join(parts)


def grid_text(grid: Sequence[int] | float | int) -> str:
    return f"{grid:.0f}" if isinstance(grid, int | float) else " x ".join(str(cells) for cells in grid)


def step_facts(data: Data) -> list[tuple[str, str]]:
    """Label and value of what is known of an outer step."""
    formats = {
        "loss": ("loss", lambda value: f"{value:.4g}"),
        "psnr": ("PSNR", lambda value: f"{value:.1f} dB"),
        "faces": ("faces", count),
        "gaussians": ("Gaussians", count),
        "rss_mb": ("memory", memory),
    }
    return [(label, show(data[key])) for key, (label, show) in formats.items() if data.get(key) is not None]


def step_line(data: Data, outer: int) -> str:
    facts = ", ".join(f"{label} {value}" for label, value in step_facts(data))
    eta = f", {duration(data['eta_s'])} left" if data.get("eta_s") is not None else ""
    return f"{100 * data['progress']:3.0f} %  step {outer}: {facts}{eta}"


def error_text(data: Data) -> str:
    """The measures of an evaluation, best known first; empty if none is known."""
    parts = []
    if data.get("chamfer_ps") is not None:
        parts.append(f"Chamfer {data['chamfer_ps']:.3g}")
    if data.get("residual_px") is not None:
        parts.append(f"residual {data['residual_px']:.2f} px")
    if data.get("psnr") is not None:
        parts.append(f"PSNR {data['psnr']:.2f} dB")
    if data.get("iou") is not None:
        parts.append(f"mask IoU {data['iou']:.4f}")
    return ", ".join(parts)


_FOR_REPLAY = ("command", "source", "refused")
"""What an action carries so that it can be done again; its message says as much."""


def message_text(data: Data) -> str:
    """A decision, an action, a warning: its subject first, the rest as it is."""
    rest = {key: value for key, value in data.items() if key not in _FOR_REPLAY}
    subject = str(rest.pop("message", None) or rest.pop("error", None) or rest.pop("item", ""))
    if "value" in rest:
        subject = f"{subject}: {rest.pop('value')}"
    details = ", ".join(f"{key.replace('_', ' ')} {_value(value)}" for key, value in rest.items() if value is not None)
    return f"{subject} ({details})" if subject and details else subject or details


def certificate_text(certificate: Data) -> str:
    if not certificate:
        return "no certificate"
    facts = ["watertight" if certificate["watertight"] else f"open, {certificate['boundary_edges']} boundary edges"]
    if certificate["watertight"] and not certificate.get("watertight_merged", True):
        facts.append(f"but open where {certificate['coincident_vertices']} vertices coincide with others")
    if certificate["watertight"] and not certificate["outward"]:
        facts.append("not turned outwards")
    components = certificate["components"]
    facts.append(f"{components} component{'' if components == 1 else 's'}")
    if certificate["genus"] is not None:
        facts.append(f"genus {certificate['genus']}")
    return ", ".join(facts)


def end_lines(data: Data, run_dir: Path) -> list[str]:
    """How the run ended, where its files are, and the error at 25, 50 and 100 % of the optimisation."""
    lines = [f"{data['status']} after {duration(data['seconds'])}"]
    final = data.get("final") or {}
    faces = f"{count(final['faces'])} faces, " if final.get("faces") is not None else ""
    for key, label in _FILES.items():
        if data.get(key) is None:
            continue
        note = f"   {faces}{certificate_text(data.get('certificate') or {})}" if key == "mesh" else ""
        lines.append(f"  {label:<10}{data[key]}{note}")
    if "mesh" not in data:
        lines.append(f"  {'results':<10}{run_dir}")
    label = "error"
    for row in data.get("milestones") or ():
        lines.append(f"  {label:<10}{100 * row['share']:3.0f} % of the optimisation: {error_text(row) or 'not known'}")
        label = ""
    return lines


def _value(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
