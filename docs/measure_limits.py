"""What few sides and few cells do to a result: the tables and the picture of docs/background/limits.md.

    python docs/measure_limits.py views [--scenes demo:dents ...] [--seen-from above front] [--max-time 180] [--out DIR]
                                        [--starts sphere visual-hull photo-hull] [--fields hash-grid mlp]
    python docs/measure_limits.py cells [--scenes demo:dents ...] [--cells 32 64 128 256] [--out DIR]

``views`` reconstructs demo scenes that are seen from the upper half only, or with one side hidden, and measures the
surface that a photograph shows and the one that none does apart. ``cells`` reconstructs scenes at several resolutions
of the grid. Runs that are in DIR already are not made again; without DIR nothing is kept.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.engine.run import load_finished
from sculpt_framework.evaluation.charts import Axis, Series, line_drawing, series_colors, sheet
from sculpt_framework.evaluation.drawing_png import to_png
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.evaluation.visibility import points_seen, seen_by, visible_distances
from sculpt_framework.export.atomic import write_atomically

PICTURE = Path(__file__).parent / "pictures" / "low-resolution.png"
METHOD = "gaussian-sculpting"
BASE_CELLS = 32
"""Cells of a stage of level 0."""
SAMPLES = 100_000
LOOKOUTS = 200
"""Outside viewpoints, all around, for what is hidden in the inside."""


@dataclass(frozen=True, kw_only=True)
class Parts:
    """Distances in scene units, shares in [0, 1]."""

    chamfer: float
    seen: float
    """Chamfer distance of the part of the reference that some train view sees."""
    unseen: float
    """Of the rest."""
    seen_share: float
    """Of the reference's area."""
    hidden: float
    """Share of the result's area that none of many viewpoints all around can see."""
    pieces: int
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    views = kinds.add_parser("views")
    views.add_argument("--scenes", nargs="+", default=["demo:dents"])
    views.add_argument("--seen-from", nargs="+", default=["above", "front"])
    views.add_argument("--starts", nargs="+", default=["sphere", "visual-hull", "photo-hull"])
    views.add_argument("--fields", nargs="+", default=["hash-grid", "mlp"])
    views.add_argument("--max-time", type=float, default=180.0)
    cells = kinds.add_parser("cells")
    cells.add_argument("--scenes", nargs="+", default=["demo:dents"])
    cells.add_argument("--cells", nargs="+", type=int, default=[32, 64, 128, 256])
    for each in (views, cells):
        each.add_argument("--out", type=Path)
    request = parser.parse_args()
    with tempfile.TemporaryDirectory() as aside:
        folder = request.out or Path(aside)
        if request.kind == "views":
            limited_views(request, folder)
        else:
            resolutions(request, folder)


def limited_views(request: argparse.Namespace, folder: Path) -> None:
    print(
        "| scene | seen from | start | field | training s | Chamfer 1e-2 | seen | unseen | hidden inside | pieces |",
        flush=True,
    )
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for scene in request.scenes:
        for placement in request.seen_from:
            for start in request.starts:
                for field in request.fields:
                    options = ["--dataset", "demo", "--dataset.seen-from", placement, "--initializer", start]
                    options += ["--field", field, "--max-time", str(request.max_time)]
                    run = train(scene, options, folder / f"{scene}-{placement}-{start}-{field}".replace(":", "-"))
                    it = measure(run)
                    print(
                        f"| {scene} | {placement} | {start} | {field} | {it.seconds:.0f} | {100 * it.chamfer:.3f} | "
                        f"{100 * it.seen:.3f} | {100 * it.unseen:.3f} | {100 * it.hidden:.2f} % | {it.pieces} |",
                        flush=True,
                    )


def resolutions(request: argparse.Namespace, folder: Path) -> None:
    print("| scene | cells | faces | training s | Chamfer 1e-2 | PSNR, held-out views |", flush=True)
    print("|---|---|---|---|---|---|", flush=True)
    errors: list[Series] = []
    for scene in request.scenes:
        points = []
        for cells in request.cells:
            level = int(np.log2(cells / BASE_CELLS))
            options = ["--trainer.base-cells", str(BASE_CELLS), "--trainer.stages.0.level", str(level)]
            run = train(scene, options, folder / f"{Path(scene).name}-{cells}".replace(":", "-"))
            final = told_by(run)["final"]
            print(
                f"| {Path(scene).name} | {cells} | {final['faces']} | {final['t_train_s']:.0f} | "
                f"{100 * final['chamfer_ps']:.3f} | {final['psnr']:.2f} dB |",
                flush=True,
            )
            points.append((float(cells), 100 * final["chamfer_ps"]))
        errors.append(Series(name=Path(scene).name, points=points))
    colors, x = series_colors(errors), Axis(label="cells along the longest side", log=True)
    panel = line_drawing("Chamfer distance", errors, x, Axis(label="1e-2", log=True), colors=colors, legend=False)
    write_atomically(PICTURE, to_png(sheet("Error by resolution", [panel], colors, columns=1)))


def train(scene: str, options: Sequence[str], out: Path) -> Path:
    if not (out / "metrics.json").is_file():
        command = [sys.executable, "-m", "sculpt_framework.cli.train", METHOD, "--data", scene, *options]
        subprocess.run([*command, "--output", str(out)], check=True, stdout=subprocess.DEVNULL)
    return out


def told_by(run: Path) -> dict[str, Any]:
    return json.loads((run / "metrics.json").read_text(encoding="utf-8"))


def measure(run: Path) -> Parts:
    """The mesh against the reference, in three ways."""
    scene, mesh, told = load_finished(run).scene, load_mesh(run / "mesh.ply"), told_by(run)
    if scene.reference_mesh is None:
        sys.exit(f"{scene.name}: no reference mesh; give demo scenes, which have one.")
    reference = MeasuredMesh(load_mesh(scene.reference_mesh), SAMPLES)
    seen = seen_by(reference, [view.camera for view in scene.train])
    shown, rest = visible_distances(mesh, reference, seen), visible_distances(mesh, reference, ~seen)
    own = MeasuredMesh(mesh, SAMPLES)
    outside = points_seen(own, own.samples.points, demo_cameras(LOOKOUTS, 400))
    return Parts(
        chamfer=told["final"]["chamfer_ps"],
        seen=shown.point_to_surface,
        unseen=rest.point_to_surface,
        seen_share=shown.seen_share,
        hidden=1.0 - float(outside.mean()),
        pieces=told["certificate"]["components"],
        seconds=told["final"]["t_train_s"],
    )


if __name__ == "__main__":
    main()
