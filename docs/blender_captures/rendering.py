"""Pictures of one capture, and where the object is in them."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from blender_captures.exr import read_passes
from blender_captures.paints import material, write_grain
from blender_captures.parts import Piece
from blender_captures.rigs import HEIGHT, WIDTH, Rig, turned
from blender_captures.rooms import ROOMS
from blender_captures.stage import (
    THREADS,
    add_camera,
    add_mesh,
    add_texture_coordinates,
    add_tint,
    empty_scene,
    put,
    shoot,
    write_passes,
)

SAMPLES = 4
COVER = "object"
"""Of the pass that tells where the object is."""
LAYER = "ViewLayer"


class Renderer:
    """An object in the room of its kind."""

    def __init__(
        self,
        room: str,
        rig: Rig,
        pieces: Sequence[Piece],
        *,
        below: Sequence[Piece],
        floor: float,
        border: int,
        folder: Path,
    ):
        """``below`` lies under the object and turns with it. ``floor`` is the height it stands on, ``border`` what is
        rendered beyond the image on each side, in pixels.

        Images of textures are put into ``folder``, from where Blender takes them.
        """
        width = WIDTH + 2 * border
        self._scene = empty_scene(width, HEIGHT + 2 * border)
        self._rig = rig
        settings = self._scene.render
        settings.threads_mode, settings.threads = "FIXED", THREADS
        write_passes(self._scene, COVER)
        self._scene.render.film_transparent = False
        cycles = self._scene.cycles
        cycles.samples, cycles.use_adaptive_sampling = SAMPLES, False
        cycles.max_bounces, cycles.sample_clamp_indirect = 2, 4
        # Slower than what it saves at so few samples.
        cycles.use_light_tree = False
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.denoiser, cycles.denoising_prefilter = "OPENIMAGEDENOISE", "FAST"
        grain = str(folder / "grain.png")
        write_grain(grain, seed=71)
        self._room = ROOMS[room](self._scene, floor, grain)
        self._object = [_placed(self._scene, *look, folder, grain, COVER) for look in _by_look(pieces)]
        self._below = [_placed(self._scene, sheet.paint, sheet.mesh, None, folder, grain, None) for sheet in below]
        self._camera = add_camera(self._scene, 2 * np.arctan(width / 2 / rig.focal))

    def shoot(self, index: int, file: Path, *, keep: bool) -> tuple[np.ndarray, np.ndarray]:
        """Linear red, green and blue, and the share that the object covers, of each pixel.

        What Blender renders goes through ``file``; if that is there, it is read and nothing is rendered.
        """
        if not file.exists():
            shot = self._rig.shots[index]
            for thing in (self._camera, *self._room.with_camera):
                put(thing, shot.stand @ shot.pose)
            for thing in self._object:
                put(thing, shot.stand)
            for thing in (*self._below, *self._room.with_object):
                put(thing, turned(shot.turn))
            self._scene.cycles.seed = index
            shoot(self._scene, file)
        passes = read_passes(file)
        if not keep:
            file.unlink()
        light = np.stack([passes[f"{LAYER}.Combined.{channel}"] for channel in "RGB"], axis=2)
        return light, passes[f"{LAYER}.{COVER}.X"]


def _by_look(pieces: Sequence[Piece]) -> list[tuple[str, trimesh.Trimesh, np.ndarray | None]]:
    """Plain pieces of one paint are one object."""
    looks, plain = [], defaultdict(list)
    for piece in pieces:
        if piece.tint is None and piece.mesh.visual.kind != "texture":
            plain[piece.paint].append(piece.mesh)
        else:
            looks.append((piece.paint, piece.mesh, piece.tint))
    return looks + [(paint, trimesh.util.concatenate(meshes), None) for paint, meshes in plain.items()]


def _placed(
    scene, paint: str, mesh: trimesh.Trimesh, tint: np.ndarray | None, folder: Path, grain: str, cover: str | None
):
    image = None
    textured = mesh.visual.kind == "texture"
    if textured:
        own = mesh.visual.material
        picture = own.image if hasattr(own, "image") else own.baseColorTexture
        image = folder / f"texture{len(scene.objects)}.png"
        picture.convert("RGB").save(image)
    look = material(paint, grain, cover=cover, tinted=tint is not None, image=str(image) if image else None)
    made = add_mesh(scene, paint, mesh, look, smooth=True)
    if tint is not None:
        add_tint(made, tint)
    if textured:
        add_texture_coordinates(made, mesh)
    return made
