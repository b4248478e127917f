"""How far the error without a reference can be trusted: beside the true error, on captures whose truth is known.

    python docs/measure_trust.py DIR... --out OUT [--pairs 12] [--pixels 250000] [--seconds 60]

DIR are captures with ``gt_mesh.ply``, as ``docs/make_captures.py`` renders them. Of each, meshes are made that are
wrong in known ways: the truth roughened, pitted, moved, scaled, smoothed, low-passed, decimated or spoilt in one half,
and what a run starts from (visual hull, photo hull) and has after ``--seconds``. Each is measured twice:
``depth_error`` by the photographs alone, and ``error``, the same percentile of how far the truth is off at the pixels
that were judged.
Lengths are in hundredths of half the longest side of the truth. Spearman's rank correlation over all meshes of all
captures is printed, also by capture, for other readings of the residual, and with ``distance``, the mean distance to
the truth over all that the cameras see; OUT/trust.png shows each mesh. ``normals`` is the mean angle to those of the
truth.
OUT/trust.csv keeps what is measured; a mesh that is in it is not made again.

Of pits three cells of 128 wide it is asked what ``plain_roughness`` says where the photographs are of the smooth truth,
and where they show the pits: the same photographs, darkened as a lamp from one side would shade the pits.
"""

import argparse
import csv
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import torch
import trimesh
from scipy import ndimage, sparse
from scipy.spatial import KDTree
from scipy.stats import spearmanr
from skimage.measure import marching_cubes

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig, InitializerConfig
from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.charts import Axis, Series, line_drawing, series_colors
from sculpt_framework.evaluation.consistency import DEPTH_ERROR_PERCENTILE, PosedImages
from sculpt_framework.evaluation.drawing import Drawing
from sculpt_framework.evaluation.drawing_png import to_png
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.evaluation.residual import Residuals, SeenMesh
from sculpt_framework.evaluation.visibility import Observed, seen_by, visible_distances
from sculpt_framework.experiments.capture_measures import radius_of
from sculpt_framework.export.decimation import decimate
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.posed_images.training_images import in_object_frame
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.types import Scene, View

FACES = 150_000
"""Of the meshes that are spoilt, where the truth has more: fine enough for three cells, and quick to measure."""
CELL = 2 / 128
"""Of a grid of 128 cells, in units of the radius."""
SAMPLES = 50_000
LEAST_DRAWN = 0.01
LAMP = np.array([0.36, -0.48, 0.8])
LENGTHS = ("depth_error", "residual_depth", "residual_depth_p90")
READINGS = (*LENGTHS, "residual_px", "residual_p90_px")
COLUMNS = ("capture", "kind", "mesh", "error", "distance", *READINGS, "judged", "normals")
TRUTH = "truth"
Spoilt = Iterator[tuple[str, str, Callable[[], Mesh]]]
"""Kinds, names, and how to make them."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path, metavar="DIR")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pairs", type=int, default=12, help="pairs of views at most")
    parser.add_argument("--pixels", type=int, default=250_000, help="of a view at most")
    parser.add_argument("--seconds", type=float, default=60, help="for the run that is not finished")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for folder in options.captures:
        measure_capture(folder, options.out, options.pairs, options.pixels, options.seconds)
    rows = read_rows(options.out / "trust.csv")
    (options.out / "trust.png").write_bytes(to_png(drawn(rows)))
    sys.stdout.write("\n".join(summary(rows)) + "\n")
    return 0


def measure_capture(folder: Path, out: Path, pairs: int, pixels: int, seconds: float) -> None:
    """Measure what has not been measured of a capture, a line each in OUT/trust.csv."""
    scene = cast(DatasetConfig, registry.default("dataset", "auto")).build(str(folder)).load()
    if scene.reference_mesh is None:
        raise SystemExit(f"{folder}: no gt_mesh.ply; expected a capture whose truth is known.")
    truth = load_mesh(scene.reference_mesh)
    radius, reference = radius_of(truth), MeasuredMesh(truth, SAMPLES)
    cameras = [view.camera for view in scene.train]
    seen, observed = seen_by(reference, cameras), Observed(cameras=cameras, box=scene.box)
    center = scene.box.center.double().numpy()
    images = PosedImages(scene.train, center, pairs_at_most=pairs, pixels_at_most=pixels)
    depths = [draw_mesh(truth.vertices, truth.faces, image.camera).depth for image in images.images]
    known = {(row["capture"], row["mesh"]) for row in read_rows(out / "trust.csv")}
    fine = with_faces(truth, radius)
    coarse = truth if len(truth.faces) <= FACES else fine
    for kind, name, make in (*spoilt(fine, coarse, radius), *starts(scene, folder, out, seconds)):
        if (folder.name, name) in known:
            continue
        try:
            mesh = make()
        except DataError as error:
            sys.stdout.write(f"{folder.name} {name}: left out, {error}\n")
            continue
        looked_at = images.seen(mesh)
        residuals = images.residuals(mesh, looked_at)
        found = images.told(mesh, looked_at, residuals)
        error = depth_error(images, looked_at, residuals, depths)
        known_truth = visible_distances(mesh, reference, seen, observed=observed)
        lengths = [error, known_truth.point_to_surface, *(getattr(found, each) for each in LENGTHS)]
        lengths = [None if x is None else 100 * x / radius for x in lengths]
        values = [*lengths, found.residual_px, found.residual_p90_px, found.judged, known_truth.normal_error]
        append_row(out / "trust.csv", [folder.name, kind, name, *values])
        sys.stdout.write(f"{folder.name} {name}: error {lengths[0]}, by photographs {lengths[2]}\n")
        sys.stdout.flush()
    if not (out / f"relief-{folder.name}.txt").exists():
        pits, relief, own = pits_and_relief(fine, radius, scene, center, pairs, pixels)
        told = f"{folder.name}: plain roughness of pits {pits}, of relief {relief}; roughness of the truth {own}\n"
        (out / f"relief-{folder.name}.txt").write_text(told, encoding="utf-8")
        sys.stdout.write(told)


def depth_error(
    images: PosedImages, looked_at: Sequence[SeenMesh], residuals: Sequence[Residuals], truth: Sequence[np.ndarray]
) -> float | None:
    """How far the truth is off, across the surface, at the pixels that photographs judge; ``truth`` is its depth in
    each of ``images``. Where a camera sees no truth it is infinitely far."""
    off = [np.empty(0)]
    for (first, _), found in zip(images.pairs, residuals, strict=True):
        rows, columns = found.places.T
        off.append(np.abs(truth[first][rows, columns] - looked_at[first].pixels.depth[rows, columns]) * found.facing)
    all_of_them = np.concatenate(off)
    # Not the mean of two of them, of which one may be infinite.
    return float(np.percentile(all_of_them, DEPTH_ERROR_PERCENTILE, method="lower")) if len(all_of_them) else None


# -- meshes that are wrong in known ways -----------------------------------------------------------------------------


def spoilt(truth: Mesh, coarse: Mesh, radius: float) -> Spoilt:
    """From the truth alone, in small faces and, to take some away, in closed ones.

    Lengths in the names are percent of the radius, or cells of 128.
    """
    normals = vertex_normals(truth.vertices, truth.faces)
    generator = np.random.default_rng(1)
    way = generator.normal(size=3)
    way /= np.linalg.norm(way)

    def off(heights: np.ndarray) -> Mesh:
        return Mesh(vertices=truth.vertices + heights[:, None] * normals, faces=truth.faces)

    yield TRUTH, TRUTH, lambda: truth
    for cells, percent in ((3, 0.3), (3, 1.0), (8, 0.3), (8, 1.0), (25, 0.5), (25, 2.0)):
        yield (
            "rough",
            f"rough-{cells}c-{percent}",
            lambda cells=cells, percent=percent: off(percent / 100 * radius * waves(truth, cells * CELL * radius)),
        )
    for depth in (1.0, 2.0):
        yield "pits", f"pits-{depth}c", lambda depth=depth: off(-pits(truth, radius, depth))
    for percent in (0.2, 0.5, 1.0, 3.0):
        vertices = truth.vertices + percent / 100 * radius * way
        yield "moved", f"moved-{percent}", lambda vertices=vertices: Mesh(vertices=vertices, faces=truth.faces)
    middle = truth.vertices.mean(axis=0)
    for percent in (-2.0, 0.5, 1.0):
        vertices = middle + (1 + percent / 100) * (truth.vertices - middle)
        yield "scaled", f"scaled-{percent}", lambda vertices=vertices: Mesh(vertices=vertices, faces=truth.faces)
    for rounds in (10, 60, 300):
        yield "smoothed", f"smoothed-{rounds}", lambda rounds=rounds: smoothed(truth, rounds)
    for cells in (0.5, 2, 5):
        yield "low-passed", f"low-passed-{cells}c", lambda cells=cells: low_passed(truth, cells)
    for faces in (6000, 1500, 400):
        yield "smoothed", f"decimated-{faces}", lambda faces=faces: fewer(coarse, faces)
    half = np.clip(10 * (truth.vertices - middle) @ way / radius, 0, 1)
    for cells, percent in ((3, 1.0), (12, 2.0)):
        yield (
            "in one half",
            f"half-{cells}c-{percent}",
            lambda cells=cells, percent=percent: off(
                percent / 100 * radius * half * waves(truth, cells * CELL * radius)
            ),
        )


def starts(scene: Scene, folder: Path, out: Path, seconds: float) -> Spoilt:
    """What runs start from, and what one has too early."""
    for name in ("visual-hull", "photo-hull"):
        yield "starts", name, lambda name=name: start(scene, name)
    yield "starts", f"run-{seconds:g}s", lambda: unfinished_run(folder, out / f"run-{folder.name}", seconds)


def start(scene: Scene, name: str) -> Mesh:
    """The last thing an initializer makes, at 128 cells."""
    cameras = [in_object_frame(view, scene.box) for view in scene.train]
    device = torch.device("cpu")
    initializer = cast(InitializerConfig, registry.default("initializer", name)).build()
    targets = initializer.targets(cameras, scene.box.half_sides, device)
    *_, target = targets
    x, y, z = (float(side) for side in scene.box.half_sides)
    volume = sample(target, (x, y, z), 128, device)
    values = np.pad(volume.values, 1, constant_values=float(volume.values.max()))
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    points = np.asarray(volume.origin) + volume.cell * (vertices - 0.5)
    world = scene.box.to_world(torch.from_numpy(points)).numpy()
    return Mesh(vertices=np.ascontiguousarray(world), faces=faces[:, ::-1].astype(np.int64).copy())


def unfinished_run(folder: Path, run: Path, seconds: float) -> Mesh:
    """What the default method has made of the capture by then."""
    if not (run / "mesh.ply").is_file():
        words = ["gaussian-sculpting", "--data", str(folder), "--max-time", f"{seconds:g}", "--output", str(run)]
        subprocess.run([sys.executable, "-m", "sculpt_framework.cli.train", *words], check=True, capture_output=True)
    return load_mesh(run / "mesh.ply")


def with_faces(mesh: Mesh, radius: float) -> Mesh:
    """The surface in faces that are fine enough to be spoilt, as many as that takes where it cannot be had in fewer."""
    if len(mesh.faces) > FACES:
        return fewer_if_closed(mesh, FACES)
    finer = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, CELL * radius)
    merged = trimesh.Trimesh(finer[0], finer[1], process=True)
    made = Mesh(vertices=np.array(merged.vertices), faces=np.array(merged.faces, np.int64))
    # Long thin triangles are cut into far more than that.
    return fewer_if_closed(made, 3 * FACES)


def waves(mesh: Mesh, length: float) -> np.ndarray:
    """Heights at the vertices: waves of one length in many directions, of mean square 1."""
    generator = np.random.default_rng(5)
    ways = generator.normal(size=(3, 60))
    ways *= 2 * np.pi / (length * np.linalg.norm(ways, axis=0))
    return np.sqrt(2 / 60) * np.sin(mesh.vertices @ ways + generator.uniform(0, 6, 60)).sum(axis=1)


def pits(mesh: Mesh, radius: float, depth: float) -> np.ndarray:
    """Depths at the vertices: round pits three cells wide, as many as fit side by side at random places, so many cells
    deep."""
    generator = np.random.default_rng(7)
    wide = 3 * CELL * radius
    count = int(0.5 * mesh.areas.sum() / wide**2)
    places = generator.choice(len(mesh.vertices), min(count, len(mesh.vertices)), replace=False)
    away, _ = KDTree(mesh.vertices[places]).query(mesh.vertices)
    return depth * CELL * radius * np.maximum(0, 1 - (2 * away / wide) ** 2)


def smoothed(mesh: Mesh, rounds: int) -> Mesh:
    """Each vertex goes half the way to the mean of its neighbours, so many times."""
    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    both = np.concatenate([ends, ends[:, ::-1]])
    count = len(mesh.vertices)
    near = sparse.coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count)).tocsr()
    degree = np.maximum(near.sum(axis=1), 1)[:, None]
    vertices = mesh.vertices
    for _ in range(rounds):
        vertices = 0.5 * vertices + 0.5 * (near @ vertices) / degree
    return Mesh(vertices=np.ascontiguousarray(vertices), faces=mesh.faces)


def low_passed(mesh: Mesh, cells: float) -> Mesh:
    """What is left of the solid after a Gaussian of so many cells of 128."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cell = CELL * radius_of(mesh)
    voxels = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).voxelized(cell)
    solid = voxels.fill().matrix.astype(np.float32)  # pyright: ignore[reportOptionalMemberAccess]
    blurred = ndimage.gaussian_filter(np.pad(solid, 12), cells)
    if not blurred.max() > 0.5:
        raise DataError("nothing of it is as thick as that")
    vertices, faces, _, _ = marching_cubes(blurred, 0.5)
    made = trimesh.Trimesh((vertices - 12) * cell, faces[:, ::-1])
    # Back in place: the middle of the box of what the voxels hold is that of the mesh.
    filled = np.argwhere(solid)
    made.vertices += 0.5 * (low + high) - 0.5 * cell * (filled.min(axis=0) + filled.max(axis=0))
    return Mesh(vertices=np.array(made.vertices), faces=np.array(made.faces, np.int64))


def fewer_if_closed(mesh: Mesh, faces: int) -> Mesh:
    """A mesh that is not closed keeps the faces it has."""
    try:
        return fewer(mesh, faces) if len(mesh.faces) > faces else mesh
    except DataError:
        return mesh


def fewer(mesh: Mesh, faces: int) -> Mesh:
    vertices, kept = decimate(mesh.vertices, mesh.faces, faces)
    return Mesh(vertices=vertices, faces=kept)


# -- pits and relief -------------------------------------------------------------------------------------------------


def pits_and_relief(
    truth: Mesh, radius: float, scene: Scene, center: np.ndarray, pairs: int, pixels: int
) -> tuple[float | None, float | None, float | None]:
    """``plain_roughness`` of a pitted mesh, by the photographs of the smooth truth and by those that show the pits; the
    truth's own ``roughness``, which is in both."""
    normals = vertex_normals(truth.vertices, truth.faces)
    pitted = Mesh(vertices=truth.vertices - pits(truth, radius, 1.0)[:, None] * normals, faces=truth.faces)
    shown = [with_relief(view, truth, pitted) for view in scene.train]
    smooth, relief = (
        PosedImages(each, center, pairs_at_most=pairs, pixels_at_most=pixels) for each in (scene.train, shown)
    )
    by_smooth, by_relief = (images.measure(pitted).plain_roughness for images in (smooth, relief))
    return by_smooth, by_relief, smooth.measure(truth).roughness


def with_relief(view: View, smooth: Mesh, relief: Mesh) -> View:
    """The photograph times how much brighter the relief is than the smooth surface under one lamp."""
    shades = []
    for mesh in (smooth, relief):
        drawn = draw_mesh(mesh.vertices, mesh.faces, view.camera)
        light = 0.55 + 0.45 * vertex_normals(mesh.vertices, mesh.faces) @ LAMP
        shade = drawn.interpolate(mesh.faces, np.repeat(light[:, None], 3, axis=1))
        shades.append(np.where((drawn.face >= 0)[..., None], shade, np.nan))
    ratio = np.nan_to_num(shades[1] / shades[0], nan=1.0).astype(np.float32)
    return replace(view, rgb=(view.rgb * torch.from_numpy(ratio)).clamp(0, 1))


# -- what comes out --------------------------------------------------------------------------------------------------


def append_row(path: Path, values: Sequence[object]) -> None:
    new = not path.exists()
    with open(path, "a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(COLUMNS)
        writer.writerow(["" if value is None else value for value in values])


def read_rows(path: Path) -> list[Mapping[str, str]]:
    if not path.exists():
        return []
    with open(path, encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def drawn(rows: Sequence[Mapping[str, str]]) -> Drawing:
    """A dot for each mesh, in a colour for each kind; a dashed line for what the truth of a capture leaves.

    The axes are logarithmic: what is told as no error at all is drawn at the lower end.
    """
    series = [
        Series(
            name=row["kind"],
            points=[(float(row["error"]), max(float(row["depth_error"]), LEAST_DRAWN))],
            style="level" if row["kind"] == TRUTH else "mark",
        )
        for row in complete(rows)
    ]
    colors = {**series_colors([line for line in series if line.name != TRUTH]), TRUTH: "#999999"}
    title = f"{len(series)} meshes of {len({row['capture'] for row in rows})} captures"
    x = Axis(label="true depth error, 1e-2 radius (log)", log=True)
    y = Axis(label="by photographs alone, 1e-2 radius (log)", log=True)
    return line_drawing(title, series, x, y, colors=colors, legend=True)


def summary(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Rank correlations: over everything, by capture, and of other readings of the residual."""
    known = complete(rows)
    out = [
        f"{name}: {correlation(known, name):.3f}, with the mean distance {correlation(known, name, 'distance'):.3f}"
        for name in READINGS
    ]
    for capture in dict.fromkeys(row["capture"] for row in known):
        own = [row for row in known if row["capture"] == capture]
        told = [correlation(own, "depth_error", truth) for truth in ("error", "distance")]
        out.append(f"depth_error, {capture}: {told[0]:.3f} over {len(own)}, with the mean distance {told[1]:.3f}")
    return [f"{len(known)} meshes", *out]


def complete(rows: Sequence[Mapping[str, str]]) -> list[Mapping[str, str]]:
    return [row for row in rows if row["error"] and row["distance"] and row["depth_error"]]


def correlation(rows: Sequence[Mapping[str, str]], name: str, truth: str = "error") -> float:
    pairs = np.array([(float(row[truth]), float(row[name])) for row in rows])
    return float(spearmanr(pairs[:, 0], pairs[:, 1]).statistic)  # pyright: ignore[reportAttributeAccessIssue]


if __name__ == "__main__":
    sys.exit(main())
