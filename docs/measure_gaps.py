"""What the pixels without a depth cost, where the true surface is known.

    python docs/measure_gaps.py CAPTURE ...

For captures with masks and a ``gt_mesh.ply``, such as those of ``make_captures.py``. First the share of the object's
pixels with a depth of its own, with one that bridges a gap, and with none; the median error of the former two in
hundredths of the object's radius, and how many are right to 2 hundredths. Then, in hundredths of the radius, the
distance between what cameras see of the truth and the surface that is fused before training

- from the depths that there are,
- from true depths where there is a depth of its own,
- from the depths that there are, own and bridged, and true ones where there are none,
- from true depths everywhere.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import torch
from jaxtyping import Bool

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.evaluation.visibility import Observed, seen_by, visible_distances
from sculpt_framework.experiments.capture_measures import radius_of
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.multi_view_stereo.depth_maps import DepthMaps, StereoOptions, find_depths
from sculpt_framework.multi_view_stereo.fusion import fuse
from sculpt_framework.multi_view_stereo.gaps import bridged
from sculpt_framework.posed_images.training_images import in_object_frame
from sculpt_framework.sculpting.initial_fit import start_mesh
from sculpt_framework.shape_from_images.closing import close_cones, close_unseen
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.types import Camera, Scene

NEAR_CELLS = 2
"""Within which depths agree across a gap, as in the fusion."""
RIGHT = 2.0
"""Hundredths of the radius."""
SAMPLES = 50_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", metavar="CAPTURE")
    request = parser.parse_args()
    sys.stdout.write(
        f"{'capture':18} {'own':>5} {'bridged':>7} {'none':>5}  {'median':>12} {'right':>12}  {'fused':>6} "
        f"{'true there':>10} {'true in gaps':>12} {'all true':>8}\n"
    )
    for folder in request.captures:
        scene = cast(DatasetConfig, registry.default("dataset", "auto")).build(folder).load()
        if scene.reference_mesh is None:
            parser.error(f"{folder} has no gt_mesh.ply")
        sys.stdout.write(f"{folder.rstrip('/').rsplit('/', 1)[-1]:18} {line(scene, Path(scene.reference_mesh))}\n")
        sys.stdout.flush()


def line(scene: Scene, reference: Path) -> str:
    truth, usual = load_mesh(reference), vars(registry.default("initializer", "stereo"))
    views = [in_object_frame(view, scene.box) for view in scene.train]
    cameras, cpu = [view.camera for view in views], torch.device("cpu")
    hull = visual_hull(views, len(views))
    x, y, z = (float(side) for side in scene.box.half_sides)
    solid = close_cones(sample(hull, (x, y, z), usual["cells"], cpu), cameras)
    options = StereoOptions(pixels=usual["pixels"], neighbours=usual["neighbours"], agreeing=usual["agreeing"])
    own = find_depths(views, solid, options)
    told, true = bridged(own, NEAR_CELLS * solid.cell), true_depths(own, cameras, scene, truth)
    measured = MeasuredMesh(truth, SAMPLES)
    seeing = [view.camera for view in scene.train]
    seen, observed = seen_by(measured, seeing), Observed(cameras=seeing, box=scene.box, least=1)

    def distance(maps: DepthMaps) -> float:
        shape = close_unseen(fuse(solid, maps), cameras)
        mesh = start_mesh(shape.within(hull, cpu), scene.box, usual["cells"])
        return 100 * visible_distances(mesh, measured, seen, observed=observed).point_to_surface / radius_of(truth)

    known, gaps, shown = own.depths > 0, told.depths <= 0, true.depths > 0
    filled = ~known & ~gaps
    error = 100 * np.abs(told.depths - true.depths) * scene.box.scale / radius_of(truth)
    shares = [100 * float(each[shown].mean()) for each in (known, filled, gaps)]
    medians = [float(np.median(error[each & shown])) for each in (known, filled)]
    right = [100 * float((error[each & shown] < RIGHT).mean()) for each in (known, filled)]
    distances = [distance(each) for each in (own, where(known, true, own), where(gaps, true, told), true)]
    return (
        f"{shares[0]:4.0f}% {shares[1]:6.0f}% {shares[2]:4.1f}%  {medians[0]:5.2f}, {medians[1]:5.2f} "
        f"{right[0]:5.0f}%, {right[1]:4.0f}%  {distances[0]:6.3f} {distances[1]:10.3f} {distances[2]:12.3f} "
        f"{distances[3]:8.3f}"
    )


def true_depths(maps: DepthMaps, cameras: Sequence[Camera], scene: Scene, truth: Mesh) -> DepthMaps:
    """What the maps would be of the true surface, all of it certain."""
    stack = maps.views
    vertices = (np.asarray(truth.vertices) - scene.box.center.numpy()) / scene.box.scale
    depths, normals = np.zeros_like(maps.depths), np.zeros_like(maps.normals)
    for i in range(len(stack)):
        rows, columns = (int(size) for size in stack.sizes[i])
        fx, fy, cx, cy = (float(each) for each in stack.lenses[i])
        camera = replace(cameras[stack.given[i]], fx=fx, fy=fy, cx=cx, cy=cy, width=columns, height=rows)
        depth = draw_mesh(vertices, truth.faces, camera).depth
        depth = np.where(np.isfinite(depth), depth, 0)
        y, x = np.mgrid[:rows, :columns]
        points = np.stack([(x + 0.5 - cx) / fx * depth, (y + 0.5 - cy) / fy * depth, depth], axis=-1)
        normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        depths[i, :rows, :columns] = depth
        normals[i, :rows, :columns] = -np.sign((normal * points).sum(axis=-1, keepdims=True)) * normal
    return replace(maps, depths=depths, normals=normals, confidence=(depths > 0).astype(np.float32))


def where(chosen: Bool[np.ndarray, "v h w"], one: DepthMaps, other: DepthMaps) -> DepthMaps:
    """``one`` at the chosen pixels."""
    return replace(
        other,
        depths=np.where(chosen, one.depths, other.depths),
        normals=np.where(chosen[..., None], one.normals, other.normals),
        confidence=np.where(chosen, one.confidence, other.confidence),
    )


if __name__ == "__main__":
    main()
