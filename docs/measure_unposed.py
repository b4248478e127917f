"""From photographs without cameras to a mesh, against the same with known cameras.

    python docs/measure_unposed.py DIR ... --out OUT [--masks with without]

DIR are scenes with cameras, photographs in ``images/`` and perhaps ``masks/``; ``gt_mesh.ply`` is the truth where there
is one. Of each, the photographs alone (and their masks) are copied to OUT, and a default run is made of them, which
finds cameras first, and one of the scene as it is. Meshes of found cameras are laid into the known frame by the
cameras' positions (Umeyama 1991). Printed are the share of photographs with a camera, the errors of
``docs/measure_poses.py``, the seconds of both runs, and of both meshes, with the known cameras: the distance to the
truth over what cameras see and its median, in hundredths of half the truth's longest side, and the residual in pixels;
and what each run says of its own mesh by its own cameras, the residual again, where it has no truth.
What is finished in OUT is not done again.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from measure_poses import Similarity, pose_errors, read_poses, similarity

from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.experiments.capture_measures import Capture
from sculpt_framework.posing.upright import centers


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path, metavar="DIR")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--masks", nargs="+", choices=["with", "without"], default=["without"])
    options = parser.parse_args()
    titles = ("scene", "posed", "degrees", "position %", "seconds", "", "residual px", "", "distance", "", "median", "")
    row = "{:22} {:>8} {:>8} {:>11} {:>8} {:>6} {:>11} {:>6} {:>9} {:>6} {:>7} {:>6} {:>7} {:>6}"
    print(row.format(*titles, "own px", ""))
    for folder in options.scenes:
        for masks in options.masks:
            if masks == "without" or (folder / "masks").is_dir():
                print(line_of(folder, options.out, masks == "with"), flush=True)
    return 0


def line_of(folder: Path, out: Path, masks: bool) -> str:
    """Found cameras first in every pair of columns, known ones second."""
    name = f"{folder.resolve().name}{'-masks' if masks else ''}"
    photographs = out / name
    for part in ("images", *(["masks"] if masks else [])):
        shutil.copytree(folder / part, photographs / part, dirs_exist_ok=True)
    found_run, known_run = out / f"{name}-found", out / f"{name}-known"
    train(photographs, found_run, [])
    train(folder, known_run, [] if masks else ["--dataset.masks", "ignored"])
    known, posed = read_poses(str(folder)), read_poses(str(out / f"{name}-posed"))
    errors = pose_errors(known, posed)
    both = sorted(known.keys() & posed.keys())
    fit = similarity(*(centers(np.array([poses[each] for each in both])) for poses in (posed, known)))
    meshes = placed(load_mesh(found_run / "mesh.ply"), fit), load_mesh(known_run / "mesh.ply")
    finals = [json.loads((run / "metrics.json").read_text(encoding="utf-8"))["final"] for run in (found_run, known_run)]
    seconds = [final["t_wall_s"] for final in finals]
    capture = Capture(str(folder))
    measured = [measures(capture, mesh) for mesh in meshes]
    pairs = " ".join(
        f"{told(of_found, 3):>{wide}} {told(of_known, 3):>6}"
        for wide, of_found, of_known in zip((11, 9, 7), *measured, strict=True)
    )
    return (
        f"{name:22} {len(both):>3} / {len(known):<2} {np.median(errors.degrees):8.3f} "
        f"{100 * np.median(errors.shares):11.3f} {seconds[0]:8.0f} {seconds[1]:6.0f} {pairs} "
        f"{told(finals[0]['residual_px'], 3):>7} {told(finals[1]['residual_px'], 3):>6}"
    )


def train(data: Path, run: Path, more: list[str]) -> None:
    if not (run / "metrics.json").is_file():
        words = ["gaussian-sculpting", "--data", str(data), "--output", str(run), *more]
        subprocess.run(
            [sys.executable, "-m", "sculpt_framework.cli.train", *words], check=True, stdout=subprocess.DEVNULL
        )


def placed(mesh: Mesh, fit: Similarity) -> Mesh:
    return Mesh(vertices=fit.scale * mesh.vertices @ fit.rotation.T + fit.shift, faces=mesh.faces)


def measures(capture: Capture, mesh: Mesh) -> tuple[float | None, float | None, float | None]:
    """Residual in pixels; distance and its median, hundredths of the radius, None without truth."""
    found = capture.measure(mesh)
    lengths = (found.get(name) for name in ("distance", "distance_median"))
    distance, median = (None if each is None else 100 * each / capture.radius for each in lengths)
    return found["residual_px"], distance, median


def told(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


if __name__ == "__main__":
    sys.exit(main())
