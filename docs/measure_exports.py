"""What is lost on the way into a file: by a texture against the splats, by fewer faces against the whole mesh.

    python docs/measure_exports.py RUN_DIR... [--texture-size 2048] [--target-faces 20000] [--whole] [--keep FOLDER]

Two tables, a row a run that has finished. The first renders the test views of the run on white, as ``sculpt-eval``
does: from its Gaussians, from its mesh with vertex colours, and from the textured GLB that ``sculpt-export`` writes,
read back from the file by another library; with the file's size and the seconds of the command, reading the
photographs included. The GLB is of the simplified mesh; with ``--whole`` also of the whole one. The second measures the
simplified mesh against the reference mesh, as the whole one; runs without a reference, or with a mesh that is small
enough already, have no row in it.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh

from sculpt_framework.engine.run import FinishedRun, load_finished
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.images import psnr
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.export.assets import TexturedMesh
from sculpt_framework.export.mesh_files import read_colored_mesh
from sculpt_framework.export.pictures import paint
from sculpt_framework.export.texture import Atlas, Texture
from sculpt_framework.types import Camera

SAMPLES = 200_000


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", nargs="+", type=Path)
    parser.add_argument("--texture-size", type=int, default=2048)
    parser.add_argument("--target-faces", type=int, default=20_000)
    parser.add_argument("--whole", action="store_true", help="also put a texture on the mesh with all its faces")
    parser.add_argument("--keep", type=Path, help="where to leave the GLB files")
    options = parser.parse_args()
    finished = [(folder, load_finished(folder)) for folder in options.run_dir]
    print(
        "| run | faces | splats, dB | vertex colours, dB | faces in GLB | textured, dB | against splats | MiB | s |",
        flush=True,
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as aside:
        keep = options.keep or Path(aside)
        keep.mkdir(parents=True, exist_ok=True)
        size = ("--texture-size", str(options.texture_size))
        few = ("--target-faces", str(options.target_faces))
        for folder, run in finished:
            splats = run.test_measures()["psnr"]
            if splats is None:
                raise ValueError(f"{folder} has no test views: nothing can be compared")
            before = f"{folder.name} | {plain_cells(folder, run, splats)}"
            print(
                f"| {before} | {textured_cells(folder, run, splats, keep / f'{folder.name}.glb', *size, *few)} |",
                flush=True,
            )
            if options.whole:
                print(
                    f"| {before} | {textured_cells(folder, run, splats, keep / f'{folder.name}-whole.glb', *size)} |",
                    flush=True,
                )
    print("", flush=True)
    print(f"| run | faces | Chamfer | faces of {options.target_faces} | watertight | Chamfer | ratio |", flush=True)
    print("|---|---|---|---|---|---|---|", flush=True)
    for folder, run in finished:
        row = decimation_row(folder, run, options.target_faces)
        if row is not None:
            print(row, flush=True)
    return 0


def plain_cells(folder: Path, run: FinishedRun, splats: float) -> str:
    """Faces, and what the run itself looks like. Raises ValueError where its mesh has no colours."""
    vertices, faces, colors = read_colored_mesh(folder / "mesh.ply")
    if colors is None:
        raise ValueError(f"{folder}/mesh.ply has no colours")
    plain = mean_psnr(run, lambda camera: paint(vertices, faces, colors, camera))
    return f"{len(faces)} | {splats:.2f} | {plain:.2f}"


def textured_cells(folder: Path, run: FinishedRun, splats: float, out: Path, *words: str) -> str:
    """Faces, peak signal-to-noise ratio (mean over the test views), size and seconds of a textured GLB."""
    # With y for up nothing is turned: the mesh stays where the run's cameras look.
    seconds = export(folder, out, "--format", "glb", "--texture", "--up", "Y", *words)
    mesh = read_textured(out)
    found = mean_psnr(run, lambda camera: paint(mesh.vertices, mesh.faces, mesh, camera))
    return f"{len(mesh.faces)} | {found:.2f} | {found - splats:+.2f} | {out.stat().st_size / 2**20:.1f} | {seconds:.0f}"


def mean_psnr(run: FinishedRun, picture: Callable[[Camera], np.ndarray]) -> float:
    """Over the test views, on white."""
    scores = []
    for view in run.scene.test:
        rgb = view.rgb.numpy()
        target = rgb if view.alpha is None else rgb * view.alpha.numpy()[..., None] + 1 - view.alpha.numpy()[..., None]
        scores.append(psnr(picture(view.camera), target))
    return float(np.mean(scores))


def read_textured(path: Path) -> TexturedMesh:
    """A textured GLB as it is in the file."""
    (part,) = trimesh.load_scene(path, process=False).geometry.values()
    vertices, faces = np.array(part.vertices, np.float64), np.array(part.faces, np.int64)
    picture = np.asarray(part.visual.material.baseColorTexture.convert("RGB"))
    atlas = Atlas(
        source=np.arange(len(vertices)),
        faces=faces,
        uv=np.array(part.visual.uv, np.float64),
        width=picture.shape[1],
        height=picture.shape[0],
    )
    texture = Texture(rgb=(picture / 255).astype(np.float32), seen_share=1.0)
    return TexturedMesh(vertices=vertices, faces=faces, atlas=atlas, texture=texture)


def decimation_row(folder: Path, run: FinishedRun, target: int) -> str | None:
    """None where there is no reference or nothing to simplify."""
    reference = run.config.reference or run.scene.reference_mesh
    whole = load_mesh(folder / "mesh.ply")
    if reference is None or len(whole.faces) <= target:
        return None
    with tempfile.TemporaryDirectory() as aside:
        out = Path(aside) / "mesh.ply"
        export(folder, out, "--format", "ply", "--target-faces", str(target))
        few = load_mesh(out)
    before, after = distances((whole, few), load_mesh(reference))
    closed = "yes" if certify(few.vertices, few.faces).watertight else "NO"
    few_faces = f"{len(few.faces)} | {closed} | {after:.3e} | {after / before:.3f}"
    return f"| {folder.name} | {len(whole.faces)} | {before:.3e} | {few_faces} |"


def distances(meshes: Sequence[Mesh], reference: Mesh) -> list[float]:
    """Point-to-surface Chamfer distances, in scene units."""
    prepared = MeasuredMesh(reference, SAMPLES)
    return [chamfer(mesh, prepared, samples=SAMPLES, point_to_point=False).point_to_surface for mesh in meshes]


def export(folder: Path, out: Path, *words: str) -> float:
    """``sculpt-export``, and the seconds it took."""
    started = time.monotonic()
    command = [sys.executable, "-m", "sculpt_framework.cli.export", str(folder), "--out", str(out), *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.monotonic() - started


if __name__ == "__main__":
    sys.exit(main())
