"""How well objects are found in photographs without masks, against masks that are there.

    python docs/measure_masks.py SCENE ...
    python docs/measure_masks.py --run RUN_DIR SCENE

Reads each scene with its files of masks ignored, and compares what is found with them: intersection over union, of all
train images. With ``--run``, the outlines of the mesh of a finished run of that scene are compared instead: what
``sculpt-data masks RUN_DIR`` writes.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.engine.run import MESH_NAME
from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.export.outlines import covered_by
from sculpt_framework.types import View


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="SCENE")
    parser.add_argument("--run", type=Path, metavar="RUN_DIR")
    options = parser.parse_args()
    if options.run and len(options.scenes) > 1:
        parser.error("--run: expected one SCENE.")
    print(f"{'scene':20} {'images':>6} {'IoU':>6} {'worst':>6} {'seconds':>7}", flush=True)
    usual = cast(DatasetConfig, registry.default("dataset", "auto"))
    for folder in options.scenes:
        given = usual.build(folder).load().train
        started = time.monotonic()
        if options.run:
            mesh = load_mesh(options.run / MESH_NAME)
            found, notes = covered_by(mesh.vertices, mesh.faces, given), ()
        else:
            try:
                scene = replace(usual, **{"masks": "ignored"}).build(folder).load()
            except DataError as error:
                print(f"{folder}: {error}", flush=True)
                continue
            found, notes = scene.train, scene.notes
        seconds = time.monotonic() - started
        alike = overlaps(given, found)
        name = folder.rstrip("/").rsplit("/", 1)[-1]
        print(f"{name:20} {len(alike):6} {np.mean(alike):6.3f} {min(alike):6.3f} {seconds:7.1f}", flush=True)
        for note in notes:
            print(f"    {note}", flush=True)


def overlaps(given: Sequence[View], found: Sequence[View]) -> list[float]:
    """Intersection over union, of each view of the same name in both with a mask in both."""
    truths = {view.name: view.alpha for view in given}
    out = []
    for view in found:
        truth, mask = truths[view.name], view.alpha
        if truth is not None and mask is not None:
            both, either = (truth > 0.5) & (mask > 0.5), (truth > 0.5) | (mask > 0.5)
            out.append(float(both.sum()) / max(1, int(either.sum())))
    return out


if __name__ == "__main__":
    main()
