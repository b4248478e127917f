"""``sculpt-eval``: measure a finished run on its test views, or any mesh against a reference or photographs."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import ConfigError

if TYPE_CHECKING:
    from sculpt_framework.config import DatasetConfig
    from sculpt_framework.evaluation.geometry import MeasuredMesh
    from sculpt_framework.types import Scene


@dataclass(frozen=True, kw_only=True)
class EvaluateRequest:
    """Measure a finished run (RUN_DIR), or a mesh against a reference (--mesh A --reference B) or photographs (--mesh A
    --data DIR --consistency)."""

    run_dir: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_DIR", help_behavior_hint="")] = (
        None
    )
    """Run directory: its test views are rendered again, and its mesh is measured if there is a reference."""
    mesh: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Mesh to measure: PLY, OBJ, GLB, STL or OFF."""
    reference: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Mesh to compare with, in the same frame and units. A run brings its own, if it has one."""
    data: Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """With --mesh and --consistency: the photographs, in any layout that sculpt-train recognises. A run has its own."""
    samples: Annotated[int, tyro.conf.arg(metavar="N")] = 200_000
    """Area-uniform samples on each of the two surfaces."""
    self_intersections: Flag = False
    """Also count pairs of faces that cross each other."""
    visible_only: Flag = False
    """Of a run: also measure over that part of the reference alone which some train view sees."""
    consistency: Flag = False
    """Also measure what the mesh leaves unmatched between neighbouring photographs, and its roughness."""
    json: Flag = False
    """Print JSON."""


def main() -> None:
    """The console script ``sculpt-eval``."""
    exit_codes.run(lambda: evaluate(sys.argv[1:]))


def evaluate(words: Sequence[str]) -> None:
    """Measure and print. Raises SculptError; exits as tyro does for ``--help`` and values of a wrong type."""
    request = tyro.cli(EvaluateRequest, args=words, prog="sculpt-eval")
    if request.samples < 1:
        raise ConfigError(f"--samples is {request.samples}; expected 1 or more.")
    if request.visible_only and request.run_dir is None:
        raise ConfigError("--visible-only needs the cameras of a run: sculpt-eval RUN_DIR --visible-only.")
    if (request.data is not None) != (request.consistency and request.run_dir is None):
        raise ConfigError(
            "--consistency needs a run, sculpt-eval RUN_DIR, or --mesh A with --data DIR; --data is for that."
        )
    if request.mesh is not None and request.run_dir is None:
        report = _of_mesh(request.mesh, request.reference, _prepared(request.reference, request), request)
        if request.data is not None:
            report["consistency"] = _consistency(request.mesh, _scene(request.data))
    elif request.run_dir is not None and request.mesh is None:
        report = _of_run(request.run_dir, request)
    else:
        raise ConfigError("sculpt-eval measures either a run, sculpt-eval RUN_DIR, or a mesh: --mesh A --reference B.")
    if request.json:
        from sculpt_framework.export.json_text import json_text

        sys.stdout.write(json_text(report, indent=2) + "\n")
    else:
        sys.stdout.write("\n".join(_lines(report)) + "\n")


def _prepared(reference: Path | None, request: EvaluateRequest) -> "MeasuredMesh | None":
    from sculpt_framework.evaluation.geometry import measured_file

    return None if reference is None else measured_file(reference, request.samples)


def _of_mesh(
    path: Path, reference: Path | None, prepared: "MeasuredMesh | None", request: EvaluateRequest
) -> dict[str, Any]:
    from sculpt_framework.evaluation.mesh import load_mesh
    from sculpt_framework.evaluation.mesh_report import mesh_report

    mesh = load_mesh(path)
    measures = mesh_report(mesh, prepared, samples=request.samples, self_intersections=request.self_intersections)
    return {
        "schema": 1,
        "mesh": str(path),
        "reference": None if reference is None else str(reference),
        **measures,
    }


def _of_run(run_dir: Path, request: EvaluateRequest) -> Mapping[str, Any]:
    from sculpt_framework.engine.run import load_finished

    finished = load_finished(run_dir)
    reference = request.reference or finished.config.reference or finished.scene.reference_mesh
    prepared = _prepared(reference, request)
    if request.visible_only and prepared is None:
        raise ConfigError("--visible-only needs a reference mesh, and the run has none; give --reference FILE.")
    report = _of_mesh(run_dir / "mesh.ply", reference, prepared, request)
    if request.visible_only and prepared is not None:
        from sculpt_framework.evaluation.mesh import load_mesh
        from sculpt_framework.evaluation.visibility import seen_by, visible_distances

        seen = seen_by(prepared, [view.camera for view in finished.scene.train])
        report["visible"] = asdict(visible_distances(load_mesh(run_dir / "mesh.ply"), prepared, seen))
    if request.consistency:
        report["consistency"] = _consistency(run_dir / "mesh.ply", finished.scene)
    return {**report, "test_views": len(finished.scene.test), "images": finished.test_measures()}


def _scene(data: str) -> "Scene":
    from sculpt_framework import registry

    return cast("DatasetConfig", registry.default("dataset", "auto")).build(data).load()


def _consistency(mesh: Path, scene: "Scene") -> Mapping[str, float | None]:
    from sculpt_framework.evaluation.consistency import EVALUATION_PIXELS, PosedImages
    from sculpt_framework.evaluation.mesh import load_mesh

    images = PosedImages(scene.train, scene.box.center.double().numpy(), pixels_at_most=EVALUATION_PIXELS)
    return images.measure(load_mesh(mesh)).values()


def _lines(report: Mapping[str, Any]) -> list[str]:
    from sculpt_framework.evaluation.mesh_report import mesh_report_lines

    lines = [f"{'mesh':<34}{report['mesh']}"]
    lines.append(f"{'reference':<34}{report['reference'] or 'none: distances are not known'}")
    if (images := report.get("images")) is not None:
        views = report["test_views"]
        lines.append(f"{'test views':<34}{views if views else 'none: image measures are not known'}")
        labels = {
            "psnr": ("PSNR", "{:.2f} dB"),
            "psnr_fitted": ("  light fitted", "{:.2f} dB"),
            "ssim": ("SSIM", "{:.4f}"),
            "iou": ("mask IoU", "{:.4f}"),
        }
        lines += [
            f"{label:<34}{style.format(images[key])}"
            for key, (label, style) in labels.items()
            if images.get(key) is not None
        ]
    return lines + mesh_report_lines(report)
