"""Blender's side: a scene of Cycles on the CPU, with meshes, lamps and one camera in it."""

import math
from collections.abc import Sequence
from pathlib import Path

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np
import trimesh
from jaxtyping import Float64
from mathutils import Matrix, Vector  # pyright: ignore[reportMissingImports]

THREADS = 2


def empty_scene(width: int, height: int):
    """Cycles with few samples and the denoiser."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.samples, scene.cycles.max_bounces = 16, 5
    scene.cycles.use_adaptive_sampling, scene.cycles.adaptive_threshold = True, 0.05
    scene.cycles.use_denoising, scene.render.use_persistent_data = True, True
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.film_transparent = True
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.view_settings.view_transform = "Standard"
    return scene


def sky(scene, color: tuple[float, float, float], strength: float) -> None:
    """Light from everywhere."""
    world = bpy.data.worlds.new("sky")
    scene.world, world.use_nodes = world, True
    background = world.node_tree.nodes["Background"]
    background.inputs[0].default_value, background.inputs[1].default_value = (*color, 1), strength


def add_mesh(scene, name: str, mesh: trimesh.Trimesh, material, *, smooth: bool = False):
    """``smooth``: normals are interpolated but over edges of more than 30 degrees."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    data.materials.append(material)
    if smooth:
        data.shade_smooth()
        data.set_sharp_from_angle(angle=math.radians(30))
    made = bpy.data.objects.new(name, data)
    scene.collection.objects.link(made)
    return made


def add_tint(made, tint: Float64[np.ndarray, "v 3"]) -> None:
    """Linear colours of the vertices, as the attribute "tint"."""
    attribute = made.data.attributes.new("tint", "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", np.concatenate([tint, np.ones((len(tint), 1))], axis=1).astype("f4").ravel())


def add_texture_coordinates(made, mesh: trimesh.Trimesh) -> None:
    layer = made.data.uv_layers.new(name="uv")
    layer.data.foreach_set("uv", np.asarray(mesh.visual.uv, "f4")[mesh.faces].ravel())


def add_area_lamp(scene, place: Sequence[float], watts: float, size: float, color: Sequence[float] = (1, 1, 1)):
    """A square that shines towards the origin."""
    lamp = bpy.data.lights.new("lamp", "AREA")
    lamp.energy, lamp.size, lamp.color = watts, size, color
    return _add_lamp(scene, lamp, place, (0, 0, 0))


def add_spot(
    scene, place: Sequence[float], target: Sequence[float], watts: float, angle: float, color: Sequence[float]
):
    """A cone of ``angle`` degrees."""
    lamp = bpy.data.lights.new("spot", "SPOT")
    lamp.energy, lamp.spot_size, lamp.spot_blend, lamp.color = watts, math.radians(angle), 0.4, color
    lamp.shadow_soft_size = 0.05
    return _add_lamp(scene, lamp, place, target)


def _add_lamp(scene, lamp, place: Sequence[float], target: Sequence[float]):
    stand = bpy.data.objects.new("lamp", lamp)
    stand.location, stand.rotation_euler = place, facing(place, target)
    scene.collection.objects.link(stand)
    return stand


def facing(place: Sequence[float], target: Sequence[float]):
    """Euler angles of a lamp or a camera at ``place`` that looks at ``target``."""
    return (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()


def add_camera(scene, angle: float):
    """The scene's; ``angle`` is what the image's width spans, in radians."""
    lens = bpy.data.cameras.new("camera")
    lens.angle = angle
    camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def write_passes(scene, cover: str) -> None:
    """Linear light and the pass ``cover`` of materials into one file, without compression."""
    kind = scene.render.image_settings
    kind.media_type = "MULTI_LAYER_IMAGE"
    kind.file_format, kind.exr_codec, kind.use_exr_interleave, kind.color_depth = (
        "OPEN_EXR_MULTILAYER",
        "NONE",
        True,
        "16",
    )
    made = scene.view_layers[0].aovs.add()
    made.name, made.type = cover, "VALUE"


def put(made, pose: Float64[np.ndarray, "4 4"]) -> None:
    made.matrix_world = Matrix(pose.tolist())


def shoot(scene, picture: Path) -> None:
    """Render into a file, which is whole or not there."""
    aside = picture.with_name(f".{picture.stem}.partial{picture.suffix}")
    scene.render.filepath = str(aside)
    bpy.ops.render.render(write_still=True)
    aside.replace(picture)
