"""How right depth maps are where the true surface is known.

    python docs/measure_depths.py CAPTURE ... [--pixels 384]

For captures with a ``gt_mesh.ply``, such as those of ``make_captures.py``: error of the depths that multi-view stereo
finds against those of the true surface, in hundredths of the object's radius, and the share of the object's pixels
whose depth is known to 0.5, 1 and 2 hundredths. Of any capture: wall seconds, CPU microseconds per pixel of the object
and view it is compared with, and the most memory the process has had so far, with all photographs in it.
"""

import argparse
import sys
import time
from dataclasses import replace
from typing import cast

import numpy as np

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.experiments.capture_measures import radius_of
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.memory import peak_megabytes
from sculpt_framework.multi_view_stereo.depth_maps import StereoOptions
from sculpt_framework.multi_view_stereo.files import scene_depths

THRESHOLDS = (0.5, 1.0, 2.0)
"""Hundredths of the radius."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", metavar="CAPTURE")
    parser.add_argument("--pixels", type=int, help="along the object; as the initializer does if left out")
    request = parser.parse_args()
    usual = vars(registry.default("initializer", "stereo"))
    options = StereoOptions(
        pixels=request.pixels or usual["pixels"], neighbours=usual["neighbours"], agreeing=usual["agreeing"]
    )
    within = "  ".join(f"<{threshold:g}e-2" for threshold in THRESHOLDS)
    sys.stdout.write(f"{'capture':18} {'median':>7} {'p90':>7}  known  {within}  seconds  us/pixel    MiB\n")
    for folder in request.captures:
        scene = cast(DatasetConfig, registry.default("dataset", "auto")).build(folder).load()
        started, worked = time.monotonic(), time.process_time()
        found = scene_depths(scene, options, usual["cells"])
        seconds, worked = time.monotonic() - started, time.process_time() - worked
        compared = options.neighbours * sum(int((each.luminance > 0).sum()) for each in found)
        cost = f"{seconds:8.1f} {1e6 * worked / compared:9.2f} {peak_megabytes():6.0f}"
        name = folder.rstrip("/").rsplit("/", 1)[-1]
        if scene.reference_mesh is None:
            sys.stdout.write(f"{name:18} {'':42} {cost}\n")
            continue
        truth = load_mesh(scene.reference_mesh)
        errors, shown = [], 0
        for each in found:
            height, width = each.depth.shape
            inner = each.intrinsics
            camera = replace(
                each.view.camera, fx=inner[0, 0], fy=inner[1, 1], cx=inner[0, 2], cy=inner[1, 2],
                width=width, height=height,
            )  # fmt: skip
            true = draw_mesh(truth.vertices, truth.faces, camera).depth
            seen = np.isfinite(true)
            shown += int(seen.sum())
            errors.append(np.abs(each.depth - true)[seen & each.known])
        error = 100 * np.concatenate(errors) / radius_of(truth)
        shares = "  ".join(f"{100 * (error < threshold).sum() / shown:5.1f}%" for threshold in THRESHOLDS)
        median, high = np.percentile(error, [50, 90])
        known = 100 * len(error) / shown
        sys.stdout.write(f"{name:18} {median:7.3f} {high:7.3f} {known:5.1f}%  {shares} {cost}\n")


if __name__ == "__main__":
    main()
