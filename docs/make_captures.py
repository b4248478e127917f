"""Captures as hard as photographs, rendered with Blender, with the true surface, masks and cameras.

    pip install bpy manifold3d        # Blender as a Python module; its wheels are for one version of Python each
    python docs/make_captures.py all DIR
    python docs/make_captures.py museum_head lab_house DIR
    python docs/make_captures.py lab DIR --mesh FILE

writes DIR/KIND_OBJECT, for a kind or ``all`` with all of its objects or the mesh of a file, which is moved and scaled
into the unit ball; its z axis points up. An image that is there is not rendered again. Kinds:

- lab: an arm with a camera goes over a part of a sphere, the borders cut the object, the arm's shadow moves with the
  camera, bright places are over-exposed; IDR's layout, with a ``scale_mat`` that is smaller than the object.
- phone: by hand, with exposure and white balance of their own, noise, a bent lens and poses that are 0.4 pixels off;
  nerfstudio's layout, as are the others.
- turntable: camera, lamps and background stand still, the object is turned.
- museum: dark bronze and gold under spot lights.
- board: phone again, with a printed board under the object; plate: turntable again, with one under a plain object that
  turns with it. Their frame.json says what a unit is in metres.
- forest: phone again, of a part of a tree from one side, outside; shelf: phone again, before a wall, from one side.
- flipped: turntable again, and a second time with the object on its head.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from blender_captures import carvings, developing, house, pottery, printed, rigs
from blender_captures.parts import Piece, standing, united
from blender_captures.printed_board import board_below, true_frame
from make_blender_scenes import MATERIALS, bulldozer

from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.frame import write_frame


def toy() -> list[Piece]:
    """The bulldozer of ``make_blender_scenes.py``, on a plate with studs that all look alike."""
    parts = bulldozer()
    pieces = []
    for name in dict.fromkeys(material for _, material in parts):
        mesh = united([part for part, material in parts if material == name])
        pieces.append(Piece(mesh=mesh, paint="scanned", tint=np.tile(MATERIALS[name][0], (len(mesh.vertices), 1))))
    return pieces


@dataclass(frozen=True, kw_only=True)
class Kind:
    room: str
    """And the camera that goes with it."""
    rig: Callable[[], rigs.Rig]
    objects: dict[str, Callable[[], list[Piece]]]
    board: bool = False
    """Whether one lies under the object."""
    pose_error: float = 0.0
    """Pixels, root mean square, of the poses that are written."""


KINDS = {
    "lab": Kind(room="lab", rig=rigs.lab, objects={"house": house.house, "skull": carvings.skull}),
    "museum": Kind(room="museum", rig=rigs.museum, objects={"head": carvings.head, "cape": carvings.cape}),
    "turntable": Kind(room="turntable", rig=rigs.turntable, objects={"pot": carvings.pot, "statue": carvings.statue}),
    "phone": Kind(
        room="phone",
        rig=rigs.phone,
        objects={"relief": carvings.relief, "box": printed.box_and_mug, "bulldozer": toy, "jug": pottery.jug},
        pose_error=0.4,
    ),
    "board": Kind(room="phone", rig=rigs.phone, objects={"box": printed.box_and_mug}, board=True),
    "plate": Kind(room="turntable", rig=rigs.turntable, objects={"statue": carvings.plain_statue}, board=True),
    "forest": Kind(room="forest", rig=rigs.forest, objects={"trunk": carvings.trunk}, pose_error=0.4),
    "shelf": Kind(room="shelf", rig=rigs.shelf, objects={"fox": carvings.fox}, pose_error=0.4),
    "flipped": Kind(room="turntable", rig=rigs.twice, objects={"box": printed.box_and_mug}),
}
NAMES = [f"{kind}_{name}" for kind in KINDS for name in KINDS[kind].objects]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", choices=["all", *KINDS, *NAMES], metavar="CAPTURE")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mesh", type=Path, help="an object of one's own, with texture or colours; for a kind")
    parser.add_argument("--every", type=int, default=1, help="every N-th view only, to have a look")
    parser.add_argument("--keep-raw", action="store_true", help="leave what was rendered in raw/, to develop it anew")
    request = parser.parse_args()
    for word in request.captures:
        kinds = list(KINDS) if word == "all" else [word.partition("_")[0]]
        for kind in kinds:
            if request.mesh is not None:
                objects = {request.mesh.stem: lambda: loaded(request.mesh)}
            else:
                objects = {k: v for k, v in KINDS[kind].objects.items() if "_" not in word or word == f"{kind}_{k}"}
            for name, make in objects.items():
                capture(kind, make, request.folder / f"{kind}_{name}", request.every, request.keep_raw)


def loaded(path: Path) -> list[Piece]:
    """A mesh file with its texture or the colours of its vertices."""
    mesh = trimesh.load_mesh(path, process=False)
    tint = None
    if mesh.visual.kind == "vertex":
        encoded = np.asarray(mesh.visual.vertex_colors[:, :3], np.float64) / 255
        tint = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return [Piece(mesh=mesh, paint="scanned", tint=tint)]


def capture(kind: str, make: Callable[[], list[Piece]], folder: Path, every: int, keep_raw: bool) -> None:
    """One capture whole; what is there stays."""
    began = time.monotonic()
    names = ("image", "mask") if kind == "lab" else ("images", "masks")
    for name in (*names, "raw"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    made = KINDS[kind]
    rig, camera = made.rig(), developing.CAMERAS[made.room]
    pieces, truth = standing(make())
    floor = float(truth.bounds[0, 2])
    write_atomically(folder / "gt_mesh.ply", truth.export(file_type="ply"))
    write_cameras(kind, rig, folder)
    below = [board_below(floor)] if made.board else []
    if made.board:
        write_frame(true_frame(), folder)
    # Not installed with the project.
    from blender_captures.rendering import Renderer

    renderer = Renderer(made.room, rig, pieces, below=below, floor=floor, border=camera.border, folder=folder / "raw")
    for index in range(0, len(rig.shots), every):
        name = f"{index:04d}"
        image, mask = folder / names[0] / f"{name}.jpg", folder / names[1] / f"{name}.png"
        if image.exists() and mask.exists():
            continue
        light, covered = renderer.shoot(index, folder / "raw" / f"{name}.exr", keep=keep_raw)
        write_atomically(mask, developing.mask(covered, camera, rig.focal))
        write_atomically(image, developing.photograph(light, camera, rig.focal, index))
    if not keep_raw:
        for left in (folder / "raw").iterdir():
            left.unlink()
        (folder / "raw").rmdir()
    print(f"{folder}: {len(rig.shots)} views, {time.monotonic() - began:.0f} s", flush=True)


def write_cameras(kind: str, rig: rigs.Rig, folder: Path) -> None:
    if kind == "lab":
        write_atomically(folder / "cameras_sphere.npz", lambda file: np.savez(file, **rigs.idr_matrices(rig)))
        return
    camera, error = developing.CAMERAS[KINDS[kind].room], KINDS[kind].pose_error
    found = rigs.as_if_found(rig, error, seed=61) if error else rig
    names = [f"{index:04d}" for index in range(len(rig.shots))]
    write_atomically(folder / "transforms.json", developing.transforms(found, camera, names))


if __name__ == "__main__":
    main()
    # Blender's module crashes now and then while Python ends.
    sys.stdout.flush()
    os._exit(0)
