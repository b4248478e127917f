"""Photographs above the meshes made of them: one column for each run.

    python docs/make_gallery.py RUN_DIR[:VIEW] ... --out PICTURE

VIEW is the number of a train view, the middle one if it is left out. Below the photograph the mesh in its colours, and
in plain shading.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from compare_meshes import shaded

from sculpt_framework.engine.run import MESH_NAME, load_finished
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.export.drawn_mesh import draw_saved_mesh
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.viewing.layers import as_bytes

SIDE = 380
"""Pixels of a square."""
MARGIN = 0.04
"""Beside the mesh, share of the square."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", metavar="RUN_DIR[:VIEW]")
    parser.add_argument("--out", type=Path, required=True)
    request = parser.parse_args()
    columns = [column(*word.partition(":")[::2]) for word in request.runs]
    cv2.imwrite(str(request.out), np.hstack(columns)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    return 0


def column(folder: str, view: str) -> np.ndarray:
    run, path = load_finished(Path(folder)), Path(folder) / MESH_NAME
    train = run.scene.train
    chosen = train[int(view)] if view else train[len(train) // 2]
    mesh, painted = load_mesh(path), draw_saved_mesh(path)(chosen.camera).rgb
    seen = draw_mesh(mesh.vertices, mesh.faces, chosen.camera).face >= 0
    pictures = as_bytes(chosen.rgb.numpy()), as_bytes(painted.numpy()), shaded(mesh, chosen.camera)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    middle = (rows[0] + rows[-1]) / 2, (columns[0] + columns[-1]) / 2
    half = (0.5 + MARGIN) * max(rows[-1] - rows[0], columns[-1] - columns[0])
    return np.vstack([square(picture, middle, half) for picture in pictures])


def square(picture: np.ndarray, middle: tuple[float, float], half: float) -> np.ndarray:
    """The part around ``middle`` (row, column), white where the picture ends."""
    factor = SIDE / (2 * half)
    moved = np.array([[factor, 0, SIDE / 2 - factor * middle[1]], [0, factor, SIDE / 2 - factor * middle[0]]])
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    return cv2.warpAffine(picture, moved, (SIDE, SIDE), flags=how, borderValue=(255, 255, 255))


if __name__ == "__main__":
    sys.exit(main())
