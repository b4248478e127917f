"""Hard scenes to measure on, rendered with Blender: many parts, lattices, thin sheets, plain plastic, shiny metal.

    pip install bpy manifold3d        # Blender as a Python module; its wheels are for one version of Python each
    python docs/make_blender_scenes.py bulldozer DIR [--views 100] [--test-views 10] [--resolution 400]

writes ``bulldozer``, ``crane``, ``drums``, ``chair`` or ``microphone`` in NeRF-Synthetic layout, with the union of the
parts as ``gt_mesh.ply``; about two seconds a view on two cores. All are seen from the upper half only. Nothing of the
project needs Blender; docs/laboratory/ideas.md and docs/background/limits.md say what these scenes showed.
"""

import argparse
import json
import math
import random
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from blender_captures.parts import at, block, disc, rod, united
from trimesh.creation import annulus, icosphere, revolve

Part = tuple[trimesh.Trimesh, str]
"""A closed surface and the name of what it is made of."""
RADIUS, DISTANCE, ANGLE = 1.34, 4.031, 0.6911112
"""Of the ball that the object fills, of the cameras from its middle, and that a picture is wide."""
MATERIALS = {
    # colour, metallic, roughness, scale of the texture (0: plain)
    "yellow": ((0.8, 0.5, 0.02), 0, 0.25, 0),
    "grey": ((0.35, 0.35, 0.36), 0, 0.3, 0),
    "dark": ((0.03, 0.03, 0.035), 0, 0.3, 0),
    "red": ((0.6, 0.03, 0.02), 0, 0.3, 0),
    "green": ((0.05, 0.25, 0.07), 0, 0.3, 0),
    "chrome": ((0.8, 0.8, 0.82), 1, 0.12, 0),
    "steel": ((0.55, 0.56, 0.58), 1, 0.3, 0),
    "brass": ((0.8, 0.55, 0.2), 1, 0.2, 0),
    "black": ((0.02, 0.02, 0.02), 0, 0.4, 0),
    "wood": ((0.35, 0.15, 0.05), 0, 0.35, 8),
    "carpet": ((0.3, 0.08, 0.08), 0, 0.9, 30),
    "fabric": ((0.2, 0.35, 0.3), 0, 0.9, 14),
    "concrete": ((0.5, 0.5, 0.48), 0, 0.8, 20),
}
LAMPS = (((3, 2, 4), 300), ((-4, 1, 3), 150), ((0, -4, 3), 150))
"""Where they stand, and their watts."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=sorted(SCENES))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--views", type=int, default=100)
    parser.add_argument("--test-views", type=int, default=10)
    parser.add_argument("--resolution", type=int, default=400)
    request = parser.parse_args()
    parts = SCENES[request.scene]()
    whole = in_one_piece(parts)
    request.folder.mkdir(parents=True, exist_ok=True)
    whole.export(request.folder / "gt_mesh.ply")
    chance = random.Random(7)
    train = [place(chance.uniform(0.03, 0.98), chance.uniform(0, 2 * math.pi)) for _ in range(request.views)]
    test = [place(0.5, 2 * math.pi * i / request.test_views) for i in range(request.test_views)]
    render(parts, {"train": train, "test": test}, request.folder, request.resolution)


def place(height: float, turn: float) -> tuple[float, float, float]:
    """On the sphere of the cameras; ``height`` is a share of its radius."""
    away = math.sqrt(1 - height * height)
    x, y, z = away * math.cos(turn), away * math.sin(turn), height
    return DISTANCE * x, DISTANCE * y, DISTANCE * z


def in_one_piece(parts: Sequence[Part]) -> trimesh.Trimesh:
    """The union of the parts, which are moved and scaled with it to fill the ball."""
    whole = united([mesh for mesh, _ in parts])
    middle = whole.bounds.mean(axis=0)
    scale = RADIUS / np.linalg.norm(whole.vertices - middle, axis=1).max()
    for mesh in (whole, *(mesh for mesh, _ in parts)):
        mesh.apply_translation(-middle)
        mesh.apply_scale(scale)
    return whole


# -- shapes ------------------------------------------------------------------------------------------------------


def bulldozer() -> list[Part]:
    """Plain bricks with studs, tracks of many links, cooling fins, a cabin, a hollow blade."""
    parts: list[Part] = []

    def studded(middle: Sequence[float], across: int, along: int, height: float, material: str, pitch: float = 0.09):
        x, y, z = middle
        parts.append((block([across * pitch, along * pitch, height], [x, y, z + height / 2]), material))
        for i in range(across):
            for j in range(along):
                stud = [x + (i - (across - 1) / 2) * pitch, y + (j - (along - 1) / 2) * pitch, z + height + 0.014]
                parts.append((disc(0.028, 0.03, stud, sections=14), material))

    studded((0, 0, -0.62), 26, 14, 0.04, "green")
    length, radius, links = 0.6, 0.16, 34
    for side in (-0.42, 0.42):
        for link in range(links):
            way = link / links * (2 * length + 2 * math.pi * radius)
            if way < length:
                x, z, turn = -length / 2 + way, -radius, 0.0
            elif way < length + math.pi * radius:
                turn = (way - length) / radius
                x, z = length / 2 + radius * math.sin(turn), -radius * math.cos(turn)
            elif way < 2 * length + math.pi * radius:
                x, z, turn = length / 2 - (way - length - math.pi * radius), radius, math.pi
            else:
                back = (way - 2 * length - math.pi * radius) / radius
                x, z, turn = -length / 2 - radius * math.sin(back), radius * math.cos(back), math.pi + back
            parts.append((block([0.042, 0.24, 0.05], [x, side, z - 0.36], [0, -math.degrees(turn), 0]), "dark"))
        parts += [(disc(0.085, 0.16, [x, side, -0.36], [90, 0, 0], 24), "grey") for x in (-0.3, -0.1, 0.1, 0.3)]
        parts.append((block([0.7, 0.05, 0.05], [0, side, -0.36]), "grey"))
    parts += [(block([0.06, 0.9, 0.06], [x, 0, -0.36]), "grey") for x in (0.25, -0.25)]
    parts.append((block([12 * 0.09, 6 * 0.09, 0.07], [0, 0, -0.265]), "yellow"))
    studded((-0.25, 0, -0.23), 5, 6, 0.12, "yellow")
    parts += [(block([0.02, 0.36, 0.2], [0.06 + 0.06 * i, 0, -0.14]), "grey") for i in range(7)]
    parts.append((block([0.42, 0.2, 0.06], [0.24, 0, -0.20]), "dark"))
    parts += [(block([0.05, 0.05, 0.4], [x, y, 0.07]), "yellow") for x in (-0.42, -0.1) for y in (-0.22, 0.22)]
    parts.append((block([0.42, 0.54, 0.04], [-0.26, 0, 0.29]), "yellow"))
    for i in range(4):
        parts += [
            (disc(0.028, 0.03, [-0.395 + i * 0.09, -0.18 + j * 0.09, 0.32], sections=14), "yellow") for j in range(5)
        ]
    parts.append((block([0.14, 0.16, 0.12], [-0.3, 0, -0.07]), "dark"))
    parts.append((block([0.04, 0.16, 0.2], [-0.36, 0, -0.02]), "dark"))
    for side in (-0.28, 0.28):
        parts.append((rod([0.1, side, -0.2], [0.85, side, -0.28], 0.03), "grey"))
        parts.append((rod([-0.1, side, -0.05], [0.5, side, -0.2], 0.025), "grey"))
        for k in range(6):
            parts.append((disc(0.045, 0.05, [0.15 + 0.12 * k, side, -0.205 - 0.0128 * k], [90, 0, 0], 16), "red"))
    for k in range(13):
        turn = math.radians(100 + k * 13)
        middle = [1.03 + 0.24 * math.cos(turn), 0, -0.34 + 0.24 * math.sin(turn)]
        parts.append((block([0.03, 0.86, 0.062], middle, [0, -math.degrees(turn), 0]), "yellow"))
    parts += [(block([0.1, 0.04, 0.03], [1.07, -0.4 + 0.1 * k, -0.575]), "grey") for k in range(9)]
    parts += [(rod([0.3, y, -0.1], [0.3, y, 0.25], 0.03), "dark") for y in (0.2, -0.2)]
    for side in (-0.15, 0, 0.15):
        parts.append((rod([-0.5, side, -0.2], [-0.85, side, -0.3], 0.025), "grey"))
        parts.append((rod([-0.85, side, -0.3], [-0.85, side, -0.55], 0.03), "grey"))
    parts.append((rod([-0.85, -0.25, -0.3], [-0.85, 0.25, -0.3], 0.03), "red"))
    return parts


def drums() -> list[Part]:
    """Thin brass discs on thin chrome rods, drums with chrome rims, on a carpet."""
    parts: list[Part] = []

    def drum(middle: Sequence[float], radius: float, height: float, turn: Sequence[float] = (0, 0, 0)) -> None:
        parts.append((disc(radius, height, middle, turn, 48), "wood"))
        for side in (-1, 1):
            rim = at(annulus(radius - 0.005, radius + 0.025, 0.04, sections=48), [0, 0, side * height / 2])
            parts.append((at(rim, middle, turn), "chrome"))
        for k in range(8):
            x, y = (radius + 0.02) * math.cos(k * math.pi / 4), (radius + 0.02) * math.sin(k * math.pi / 4)
            parts.append((at(rod([x, y, -height / 2], [x, y, height / 2], 0.012), middle, turn), "chrome"))

    def tripod(x: float, y: float, height: float) -> None:
        parts.append((rod([x, y, -0.78], [x, y, height], 0.014), "chrome"))
        for k in range(3):
            turn = k * 2 * math.pi / 3 + x
            foot = [x + 0.22 * math.cos(turn), y + 0.22 * math.sin(turn), -0.8]
            parts.append((rod([x, y, -0.55], foot, 0.012), "chrome"))

    drum([0, 0, -0.45], 0.34, 0.4, [90, 0, 0])
    drum([-0.32, 0.05, 0.12], 0.17, 0.2, [15, -10, 0])
    drum([0.32, 0.05, 0.12], 0.17, 0.2, [15, 10, 0])
    drum([0.62, -0.25, -0.4], 0.24, 0.32)
    drum([-0.6, -0.35, -0.25], 0.2, 0.14)
    parts += [(rod([side * 0.6, 0.0, -0.15], [side, 0.05, 0.05], 0.015), "chrome") for side in (-0.32, 0.32)]
    for middle, radius, turn in (
        ([0.75, 0.35, 0.45], 0.34, [10, -12, 0]),
        ([-0.75, 0.35, 0.5], 0.32, [10, 12, 0]),
        ([-0.85, -0.3, 0.1], 0.22, [0, 0, 0]),
        ([-0.85, -0.3, 0.16], 0.22, [180, 0, 0]),
    ):
        tripod(middle[0], middle[1], middle[2] + 0.08)
        upper = [[0.0, 0.05], [0.05, 0.045], [0.08, 0.02], [radius, -0.03]]
        lower = [[radius, -0.042], [0.08, 0.006], [0.05, 0.03], [0.0, 0.035]]
        parts.append((at(revolve(np.array(upper + lower), sections=64), middle, turn), "brass"))
    tripod(-0.6, -0.35, -0.3)
    for k in range(3):
        x, y = 0.62 + 0.25 * math.cos(k * 2 * math.pi / 3), -0.25 + 0.25 * math.sin(k * 2 * math.pi / 3)
        parts.append((rod([x, y, -0.8], [x, y, -0.3], 0.014), "chrome"))
    parts.append((disc(0.2, 0.08, [0, -0.75, -0.3], sections=40), "black"))
    tripod(0, -0.75, -0.3)
    parts.append((block([2.1, 1.9, 0.03], [0, -0.1, -0.815]), "carpet"))
    return parts


def microphone() -> list[Part]:
    """A ball in a fine steel lattice on a shiny stand, and a coiled cable."""
    ball = icosphere(subdivisions=3, radius=0.42)
    corners = ball.vertices + np.array([0, 0, 0.75])
    parts: list[Part] = [(rod(corners[a], corners[b], 0.013, 8), "steel") for a, b in ball.edges_unique]
    parts.append((at(icosphere(subdivisions=4, radius=0.33), [0, 0, 0.75]), "black"))
    parts.append((at(annulus(0.40, 0.46, 0.07, sections=64), [0, 0, 0.75]), "chrome"))
    parts.append((disc(0.2, 0.2, [0, 0, 0.28], sections=48), "chrome"))
    handle = np.array([[0, 0.3], [0.2, 0.3], [0.13, -0.55], [0, -0.55]])
    parts.append((revolve(handle, sections=48), "black"))
    parts.append((rod([0, 0, -0.55], [0.0, 0, -0.9], 0.05, 24), "chrome"))
    parts.append((disc(0.5, 0.06, [0, 0, -0.95], sections=64), "chrome"))
    parts.append((block([0.05, 0.06, 0.12], [0.16, 0, 0.0]), "chrome"))
    turn = np.linspace(0, 14 * np.pi, 260)
    rising = -0.3 + 0.6 * turn / turn[-1]
    around = [0.50 + 0.06 * np.cos(turn), 0.06 * np.sin(turn) + rising, -0.86 + 0.06 * np.sin(turn + 1.2)]
    coil = np.stack(around, axis=1)
    parts += [(rod(a, b, 0.022, 8), "black") for a, b in pairwise(coil)]
    return parts


def chair() -> list[Part]:
    """Thin legs and rungs of wood, a cushion."""
    parts: list[Part] = []
    for x in (-0.5, 0.5):
        parts.append((rod([x, -0.5, -1.0], [x, -0.45, -0.1], 0.05, 16), "wood"))
        parts.append((rod([x, 0.5, -1.0], [x * 0.95, 0.55, 1.0], 0.05, 16), "wood"))
        parts.append((rod([x, -0.47, -0.6], [x, 0.5, -0.6], 0.03, 12), "wood"))
        parts.append((rod([x, -0.45, -0.1], [x, -0.45, 0.3], 0.04, 12), "wood"))
        parts.append((rod([x, -0.5, 0.3], [x, 0.52, 0.33], 0.045, 12), "wood"))
    parts.append((rod([-0.5, -0.48, -0.5], [0.5, -0.48, -0.5], 0.03, 12), "wood"))
    parts.append((block([1.1, 1.1, 0.1], [0, 0, -0.1]), "wood"))
    cushion = icosphere(subdivisions=5, radius=1)
    cushion.vertices = np.sign(cushion.vertices) * np.abs(cushion.vertices) ** 0.5 * [0.5, 0.5, 0.11]
    parts.append((cushion, "fabric"))
    parts += [(block([1.0, 0.06, 0.12], [0, 0.54, z]), "wood") for z in (0.35, 0.65, 0.95)]
    parts += [(rod([x, 0.53, 0.35], [x, 0.55, 0.95], 0.018, 10), "wood") for x in np.linspace(-0.4, 0.4, 9)]
    return parts


def crane() -> list[Part]:
    """A lattice tower and two lattice arms of thin rods, on a slab."""
    parts: list[Part] = []
    corners = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    floors = [(-0.9 + 1.5 * k / 7, 0.35 - 0.19 * k / 7) for k in range(8)]
    for (low, wide), (high, narrow) in pairwise(floors):
        below = [(x * wide, y * wide, low) for x, y in corners]
        above = [(x * narrow, y * narrow, high) for x, y in corners]
        for i in range(4):
            j = (i + 1) % 4
            parts.append((rod(below[i], above[i], 0.025), "steel"))
            parts.append((rod(below[i], above[j], 0.014), "red"))
            parts.append((rod(above[i], above[j], 0.016), "steel"))
            parts.append((rod(above[i], below[j], 0.014), "red"))
    parts.append((block([0.5, 0.4, 0.25], [0, 0, 0.72]), "yellow"))
    parts.append((block([0.3, 0.3, 0.05], [0.0, 0, 0.87]), "dark"))
    for side, length in ((1, 1.1), (-1, 0.6)):
        ends = [side * (0.25 + (length - 0.25) * k / 8) for k in range(9)]
        for a, b in pairwise(ends):
            for y in (-0.1, 0.1):
                parts.append((rod([a, y, 0.62], [b, y, 0.62], 0.02), "steel"))
                parts.append((rod([a, y, 0.62], [b, 0, 0.84], 0.012), "red"))
            parts.append((rod([a, 0, 0.84], [b, 0, 0.84], 0.02), "steel"))
            parts.append((rod([b, -0.1, 0.62], [b, 0.1, 0.62], 0.014), "steel"))
    parts.append((block([0.2, 0.3, 0.25], [-0.6, 0, 0.55]), "concrete"))
    parts.append((rod([0.9, 0, 0.62], [0.9, 0, -0.3], 0.012), "dark"))
    parts.append((block([0.25, 0.25, 0.2], [0.9, 0, -0.38]), "wood"))
    parts.append((block([1.2, 1.2, 0.1], [0, 0, -0.95]), "concrete"))
    return parts


SCENES: dict[str, Callable[[], list[Part]]] = {
    "bulldozer": bulldozer,
    "chair": chair,
    "crane": crane,
    "drums": drums,
    "microphone": microphone,
}


# -- pictures ----------------------------------------------------------------------------------------------------


def render(
    parts: Sequence[Part], places: dict[str, list[tuple[float, float, float]]], folder: Path, resolution: int
) -> None:
    """Pictures from these places by Cycles on the CPU, and the poses in transforms_SPLIT.json. What is there stays."""
    # Not installed with the project.
    import bpy  # pyright: ignore[reportMissingImports]
    from blender_captures import stage

    scene = stage.empty_scene(resolution, resolution)
    stage.sky(scene, (0.8, 0.85, 1), 0.7)
    for material in {material for _, material in parts}:
        merged = trimesh.util.concatenate([mesh for mesh, own in parts if own == material])
        assert isinstance(merged, trimesh.Trimesh)  # noqa: S101
        stage.add_mesh(scene, material, merged, painted(bpy, material))
    for where, watts in LAMPS:
        stage.add_area_lamp(scene, where, watts, 2)
    camera = stage.add_camera(scene, ANGLE)
    for split, positions in places.items():
        frames = []
        for i, where in enumerate(positions):
            camera.location, camera.rotation_euler = where, stage.facing(where, (0, 0, 0))
            bpy.context.view_layer.update()
            picture = folder / split / f"r_{i}.png"
            if not picture.exists():
                stage.shoot(scene, picture)
            pose = [list(row) for row in camera.matrix_world]
            frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": pose})
        text = json.dumps({"camera_angle_x": camera.data.angle_x, "frames": frames}, indent=1)
        (folder / f"transforms_{split}.json").write_text(text, encoding="utf-8")


def painted(bpy, name: str):
    """Blender's material of this name, with a texture of noise where it has one."""
    color, metallic, roughness, texture = MATERIALS[name]
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = metallic, roughness
    if texture:
        noise, ramp = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = texture, 6
        dark, light = ramp.color_ramp.elements
        dark.color, dark.position = (*(0.3 * each for each in color), 1), 0.35
        light.color, light.position = (*(min(1.0, 1.8 * each) for each in color), 1), 0.65
        links.new(nodes.new("ShaderNodeTexCoord").outputs["Object"], noise.inputs["Vector"])
        links.new(noise.outputs["Fac"], ramp.inputs["Fac"])
        links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    return material


if __name__ == "__main__":
    main()
