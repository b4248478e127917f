"""All that is measured of one mesh, alone and against a reference, under the names files and tables use."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import ABSOLUTE_THRESHOLDS, RELATIVE_THRESHOLDS, MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.triangle_quality import sliver_share, triangle_quality

RESULT_MEASURES: Mapping[str, str] = {
    "smallest_angle": "of all triangles, degrees",
    "largest_angle": "of all triangles, degrees",
    "mean_minimum_angle": "mean over triangles of the smallest angle, degrees",
    "mean_maximum_angle": "mean over triangles of the largest angle, degrees",
    "mean_radius_ratio": "circumradius over twice the inradius, 1 is equilateral",
    "mean_aspect_ratio": "longest side over 2 sqrt(3) inradii, 1 is equilateral",
    "radius_over4_pct": "percent of triangles with a radius ratio above 4",
    "aspect_over4_pct": "percent of triangles with an aspect ratio above 4",
    "point_to_surface": "Chamfer: mean of accuracy and completeness, scene units",
    "accuracy": "mean distance from the result to the reference, scene units",
    "completeness": "mean distance from the reference to the result, scene units",
    "point_to_surface_squared": "the same Chamfer with squared distances, scene units squared",
    "point_to_point": "Chamfer by nearest samples, scene units",
    "point_to_point_accuracy": "mean distance from the result's samples to the nearest of the reference's",
    "point_to_point_completeness": "mean distance from the reference's samples to the nearest of the result's",
    "point_to_point_squared": "Chamfer by nearest samples with squared distances, scene units squared",
    "point_to_surface_error": "standard error of point_to_surface from sampling, scene units",
    "point_to_point_floor": "what point_to_point is between two samplings of one surface, scene units",
    "reference_diagonal": "of the reference's bounding box, scene units",
    "samples": "on each surface",
    "residual_depth_p90": "90th percentile of the residual's depth, scene units",
    "depth_error": "75th percentile of the residual's depth, less what is left across epipolar lines, scene units",
    "pairs": "neighbouring views that were laid over each other",
    "plain": "share of the surface seen where the images have no texture",
    **{f"fscore_relative {t:g}": f"F-score at {100 * t:g} % of the reference's diagonal" for t in RELATIVE_THRESHOLDS},
    **{f"fscore_absolute {t:g}": f"F-score at {t:g} scene units" for t in ABSOLUTE_THRESHOLDS},
}
"""What a result is measured by beside the columns of its curve, with units."""


_COLUMNS = ("chamfer_ps", "fscore", "normal_consistency", "under10_pct")
"""Of the curve; None where nothing is known."""


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


def mesh_measures(mesh: Mesh, reference: MeasuredMesh | None, samples: int) -> dict[str, float | None]:
    """Curve columns that the mesh alone, or with the reference, gives. Lengths in world units."""
    out: dict[str, float | None] = dict.fromkeys(_COLUMNS)
    if len(mesh.faces) == 0:
        return out
    out["under10_pct"] = sliver_share(mesh)
    if reference is not None:
        result = chamfer(mesh, reference, samples=samples, point_to_point=False)
        if math.isfinite(result.point_to_surface):
            out["chamfer_ps"] = result.point_to_surface
            out["fscore"] = result.fscore
            out["normal_consistency"] = result.normal_consistency
    return out


def result_measures(mesh: Mesh, reference: Mesh | MeasuredMesh | None, samples: int = 200_000) -> dict[str, Any]:
    """All that is measured of a result: the curve's columns, the shapes of its triangles, and with a reference each
    variant of the distance by its own name. Lengths in world units.

    Raises ValueError if the reference has no area.
    """
    out: dict[str, Any] = dict.fromkeys(_COLUMNS)
    if len(mesh.faces) == 0:
        return out
    out |= triangle_quality(mesh).summary()
    if reference is not None:
        distances = chamfer(mesh, reference, samples=samples)
        out |= asdict(distances)
        out |= {"chamfer_ps": distances.point_to_surface, "fscore": distances.fscore}
    return out


def mesh_report_lines(report: Mapping[str, Any]) -> list[str]:
    """The report for people, one measure per line."""
    lines = []
    if (distances := report["distances"]) is not None:
        rows = {
            "Chamfer, point to surface": "point_to_surface",
            "  accuracy": "accuracy",
            "  completeness": "completeness",
            "  squared": "point_to_surface_squared",
            "Chamfer, point to point": "point_to_point",
            "  point to point, squared": "point_to_point_squared",
            "  its sampling floor": "point_to_point_floor",
            "normal consistency": "normal_consistency",
        }
        lines += [f"{label:<34}{distances[key]:.5g}" for label, key in rows.items() if distances[key] is not None]
        for kind, unit in (("relative", "of the diagonal"), ("absolute", "scene units")):
            for threshold, score in distances[f"fscore_{kind}"].items():
                lines.append(f"{f'F-score at {threshold:g} {unit}':<34}{score:.4f}")
    if (visible := report.get("visible")) is not None:
        lines.append(f"{'seen by a train view':<34}{100 * visible['seen_share']:.2f} % of the reference")
        for label, key in (("Chamfer of that part", "point_to_surface"), ("  accuracy", "accuracy")):
            lines.append(f"{label:<34}{visible[key]:.5g}")
        lines.append(f"{'  completeness':<34}{visible['completeness']:.5g}")
    if (found := report.get("consistency")) is not None:
        rows = {
            "residual between views": ("residual_px", "{:.3f} px"),
            "  90th percentile": ("residual_p90_px", "{:.3f} px"),
            "  as depth": ("residual_depth", "{:.5g}"),
            "  as depth, 90th percentile": ("residual_depth_p90", "{:.5g}"),
            "depth error of the mesh": ("depth_error", "{:.5g}"),
            "  judged": ("judged", "{:.1%} of the masks"),
            "  pairs of views": ("pairs", "{}"),
            "roughness of what is seen": ("roughness", "{:.2f} degrees"),
            "  of plain places": ("plain_roughness", "{:.2f} degrees"),
            "  plain": ("plain", "{:.1%} of what is seen"),
        }
        for label, (key, style) in rows.items():
            lines.append(f"{label:<34}{'not known' if found[key] is None else style.format(found[key])}")
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
