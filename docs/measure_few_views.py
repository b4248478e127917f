"""What a method makes of few photographs: error over the number of views, beside the visual hull of the same views.

    python docs/measure_few_views.py SCENE... [--counts 3 6 10 20] [--methods gaussian-sculpting neus]
                                     [--start stereo] [--from above] [--max-time SECONDS] [--out DIR]

A scene is anything that ``sculpt-train --data`` takes. Its train views are thinned to so many, spread evenly over the
directions they look from: each is the one farthest from those before (the first is the one nearest to the scene's first
axis). ``--from above`` takes those above the object's middle, ``--from front`` those
within 75 degrees of that axis. ``--start`` has bi-level methods begin with that initializer, whatever the plan would
choose. Told are how many degrees the median view is from the one nearest to it; with a reference mesh, the Chamfer
distance in hundredths of scene units, of the whole surface and of what any of all the train views sees of it, and the
mean angle between normals there; without one, residual and roughness by all the photographs, those that the method
did not get among them; and seconds. Meshes are kept in DIR.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

import sculpt_framework as sculpt
from sculpt_framework import registry
from sculpt_framework.config import InitializerConfig
from sculpt_framework.engine.session import Session
from sculpt_framework.evaluation.consistency import EVALUATION_PIXELS, PosedImages
from sculpt_framework.evaluation.geometry import MeasuredMesh, chamfer
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.evaluation.visibility import seen_by, visible_distances
from sculpt_framework.export.mesh_files import write_mesh_ply
from sculpt_framework.plan.evidence import gather
from sculpt_framework.posed_images.training_images import in_object_frame
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.sculpting.initial_fit import start_mesh
from sculpt_framework.types import Scene

HULL = "visual-hull"
"""Of the names of methods: no training."""
CELLS = 128
SAMPLES = 50_000
FRONT_DEGREES = 75.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--counts", nargs="+", type=int, default=[3, 6, 10, 20])
    parser.add_argument("--methods", nargs="+", default=[HULL, "gaussian-sculpting"])
    parser.add_argument("--start", choices=registry.names("initializer"))
    parser.add_argument("--from", dest="side", choices=["around", "above", "front"], default="around")
    parser.add_argument("--max-time", type=float)
    parser.add_argument("--out", type=Path)
    request = parser.parse_args()
    print("| scene | views | degrees apart | method | Chamfer 1e-2, of what is seen, normals; or residual | seconds |")
    print("|---|---|---|---|---|---|", flush=True)
    for data in request.scenes:
        whole = sculpt.load(data)
        measure = by_photographs(whole) if whole.reference_mesh is None else by_reference(whole, whole.reference_mesh)
        for count in request.counts:
            scene = thinned(whole, count, request.side)
            apart = gather(scene).apart
            for name in request.methods:
                began = time.perf_counter()
                mesh = made(scene, name, request.start, request.max_time)
                seconds = time.perf_counter() - began
                if request.out is not None:
                    request.out.mkdir(parents=True, exist_ok=True)
                    path = request.out / f"{whole.name}-{len(scene.train)}-{name}.ply"
                    write_mesh_ply(path, mesh.vertices, mesh.faces)
                print(
                    f"| {whole.name} | {len(scene.train)} | {apart:.1f} | {name} | {measure(mesh)} | {seconds:.0f} |",
                    flush=True,
                )


def by_reference(whole: Scene, truth: Path) -> Callable[[Mesh], str]:
    reference = MeasuredMesh(load_mesh(truth), SAMPLES)
    seen = seen_by(reference, [view.camera for view in whole.train])

    def measured(mesh: Mesh) -> str:
        full = chamfer(mesh, reference, samples=SAMPLES, point_to_point=False).point_to_surface
        shown = visible_distances(mesh, reference, seen)
        return f"{100 * full:.3f}, {100 * shown.point_to_surface:.3f}, {shown.normal_error:.1f}°"

    return measured


def by_photographs(whole: Scene) -> Callable[[Mesh], str]:
    images = PosedImages(whole.train, whole.box.center.double().numpy(), pixels_at_most=EVALUATION_PIXELS)

    def measured(mesh: Mesh) -> str:
        found = images.measure(mesh)
        return f"{found.residual_px:.3f} px, roughness {found.roughness:.1f}°"

    return measured


def thinned(scene: Scene, count: int, side: str) -> Scene:
    """The scene with so many of its train views, or all there are from that side if those are fewer."""
    middle = scene.box.to_world(scene.box.half_sides.new_zeros(1, 3))[0].numpy()
    places = np.stack([view.camera.position.double().numpy() for view in scene.train]) - middle
    directions = places / np.linalg.norm(places, axis=1, keepdims=True)
    allowed = np.flatnonzero(
        {
            "around": np.ones(len(directions), bool),
            "above": directions[:, 2] > 0,
            "front": directions[:, 0] > np.cos(np.radians(FRONT_DEGREES)),
        }[side]
    )
    chosen = allowed[spread(directions[allowed], count)]
    return replace(scene, train=[scene.train[index] for index in sorted(chosen)])


def spread(directions: Float[np.ndarray, "n 3"], count: int) -> list[int]:
    """Of unit vectors, so many, each the one farthest from those before."""
    chosen = [int(directions[:, 0].argmax())]
    nearest = directions @ directions[chosen[0]]
    while len(chosen) < min(count, len(directions)):
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return chosen


def made(scene: Scene, name: str, start: str | None, max_time: float | None) -> Mesh:
    if name == HULL:
        hull = initializer(HULL)
        views = [in_object_frame(view, scene.box) for view in scene.train]
        *_, function = hull.build().targets(views, scene.box.half_sides, torch.device("cpu"))
        return start_mesh(function, scene.box, CELLS)
    config = sculpt.methods[name]()
    if start is not None and isinstance(config, SculptingConfig):
        config = replace(config, initializer=initializer(start))
    return Session(scene, config, max_time=max_time).run().mesh


def initializer(name: str) -> InitializerConfig:
    config = registry.default("initializer", name)
    assert isinstance(config, InitializerConfig)  # noqa: S101
    return config


if __name__ == "__main__":
    main()
