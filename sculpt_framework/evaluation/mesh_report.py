"""All that is measured of one mesh, alone and against a reference, under the names files and tables use."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.triangle_quality import triangle_quality


def mesh_report(
    mesh: Mesh, reference: Mesh | MeasuredMesh | None, *, samples: int = 200_000, self_intersections: bool = False
) -> Mapping[str, Any]:
    """Nested numbers by name: ``distances`` (None without a reference), ``triangles`` (None without faces) and
    ``certificate``. Raises ValueError if the reference has no area.
    """
    certificate = certify(mesh.vertices, mesh.faces, self_intersections=self_intersections)
    distances = None
    if reference is not None:
        measured = chamfer(mesh, reference, samples=samples)
        distances = {**asdict(measured), "fscore": measured.fscore}
    return {
        "distances": distances,
        "triangles": triangle_quality(mesh).summary() if len(mesh.faces) else None,
        "certificate": asdict(certificate),
    }


def mesh_report_lines(report: Mapping[str, Any]) -> list[str]:
    """The report for people, one measure per line."""
    lines = []
    if (distances := report["distances"]) is not None:
        rows = {
            "Chamfer, point to surface": "point_to_surface",
            "  accuracy": "accuracy",
            "  completeness": "completeness",
            "Chamfer, point to point": "point_to_point",
            "  its sampling floor": "point_to_point_floor",
            "normal consistency": "normal_consistency",
        }
        lines += [f"{label:<34}{distances[key]:.5g}" for label, key in rows.items() if distances[key] is not None]
        for kind, unit in (("relative", "of the diagonal"), ("absolute", "scene units")):
            for threshold, score in distances[f"fscore_{kind}"].items():
                lines.append(f"{f'F-score at {threshold:g} {unit}':<34}{score:.4f}")
    if (triangles := report["triangles"]) is not None:
        lines.append(f"{'triangles under 10 degrees':<34}{triangles['under10_pct']:.3f} %")
        lines.append(f"{'mean smallest angle':<34}{triangles['mean_minimum_angle']:.1f} degrees")
        lines.append(f"{'aspect ratio above 4':<34}{triangles['aspect_over4_pct']:.3f} %")
    for name, value in report["certificate"].items():
        if value is not None:
            lines.append(f"{name.replace('_', ' '):<34}{_fact(value)}")
    return lines


def _fact(value: bool | int | float) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
