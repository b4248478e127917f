"""What surfaces look like: Blender's nodes, all with grain as fine as a pixel, as photographs have."""

from collections.abc import Sequence
from dataclasses import dataclass

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np
from PIL import Image

GRAIN_PIXELS, GRAIN_FALL = 2048, 0.9
Color = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Paint:
    """Colours are linear; lengths are shares of the object's radius."""

    colors: tuple[Color, Color, Color]
    """Of the darkest, the middle and the brightest places."""
    scale: float = 1.0
    """Of the grain, which has features from 1 / 2 to 1 / 500 of the object's radius."""
    contrast: float = 1.0
    """1: from the darkest to the brightest colour."""
    roughness: tuple[float, float] = (0.6, 0.9)
    metallic: float = 0.0
    bricks: float = 0.0
    """Bricks along the object's radius, on walls along x and y; 0: none."""
    glow: float = 0.0
    """Emission."""


PAINTS = {
    "brick": Paint(colors=((0.12, 0.02, 0.012), (0.3, 0.045, 0.025), (0.45, 0.11, 0.06)), bricks=15),
    "white paint": Paint(colors=((0.55, 0.55, 0.5), (0.8, 0.8, 0.76), (0.9, 0.9, 0.88)), roughness=(0.3, 0.5)),
    "glass": Paint(colors=((0.01, 0.012, 0.015), (0.02, 0.02, 0.025), (0.05, 0.05, 0.06)), roughness=(0.05, 0.12)),
    "slate": Paint(colors=((0.12, 0.13, 0.15), (0.26, 0.27, 0.3), (0.42, 0.43, 0.45)), roughness=(0.3, 0.6)),
    "copper": Paint(colors=((0.02, 0.09, 0.05), (0.07, 0.22, 0.14), (0.2, 0.36, 0.27))),
    "sandstone": Paint(colors=((0.3, 0.25, 0.17), (0.5, 0.44, 0.33), (0.66, 0.6, 0.48))),
    "plaster": Paint(colors=((0.14, 0.12, 0.09), (0.36, 0.33, 0.28), (0.5, 0.48, 0.44))),
    "old plaster": Paint(colors=((0.3, 0.26, 0.2), (0.66, 0.62, 0.54), (0.82, 0.79, 0.73))),
    "bronze": Paint(colors=((0.4, 0.4, 0.4), (0.9, 0.9, 0.9), (1.6, 1.6, 1.6)), roughness=(0.22, 0.5), metallic=1),
    "gold": Paint(colors=((0.6, 0.32, 0.08), (0.95, 0.6, 0.2), (1.0, 0.74, 0.33)), roughness=(0.14, 0.34), metallic=1),
    "carved stone": Paint(colors=((0.3, 0.28, 0.24), (0.55, 0.52, 0.46), (0.85, 0.82, 0.75)), roughness=(0.7, 1)),
    "clay": Paint(colors=((0.5, 0.48, 0.46), (0.95, 0.95, 0.95), (1.3, 1.28, 1.2)), roughness=(0.35, 0.65)),
    "print": Paint(colors=((0.8, 0.8, 0.8), (0.95, 0.95, 0.95), (1.0, 1.0, 1.0)), roughness=(0.35, 0.5)),
    "glaze": Paint(colors=((0.85, 0.85, 0.85), (0.95, 0.95, 0.95), (1.0, 1.0, 1.0)), roughness=(0.12, 0.2)),
    "plain glaze": Paint(colors=((0.72, 0.72, 0.68), (0.72, 0.72, 0.68), (0.72, 0.72, 0.68)), roughness=(0.08, 0.08)),
    "scanned": Paint(colors=((0.9, 0.9, 0.9), (1.0, 1.0, 1.0), (1.1, 1.1, 1.1)), roughness=(0.5, 0.6)),
    "plain": Paint(colors=((0.7, 0.66, 0.58), (0.7, 0.66, 0.58), (0.7, 0.66, 0.58)), roughness=(0.6, 0.6)),
    "bark": Paint(colors=((0.35, 0.35, 0.35), (0.9, 0.9, 0.9), (1.5, 1.5, 1.5)), roughness=(0.7, 1)),
    "fur": Paint(colors=((0.6, 0.6, 0.6), (0.95, 0.95, 0.95), (1.2, 1.2, 1.2)), roughness=(0.7, 1)),
    # Rooms.
    "leaves": Paint(colors=((0.02, 0.05, 0.01), (0.1, 0.16, 0.04), (0.4, 0.35, 0.12)), scale=3),
    "dark cloth": Paint(colors=((0.004, 0.004, 0.005), (0.012, 0.012, 0.014), (0.03, 0.03, 0.032))),
    "wood": Paint(colors=((0.1, 0.045, 0.018), (0.28, 0.14, 0.06), (0.45, 0.27, 0.14)), scale=2.5),
    "wall": Paint(colors=((0.4, 0.4, 0.36), (0.55, 0.54, 0.5), (0.62, 0.61, 0.57))),
    "paper": Paint(colors=((0.4, 0.4, 0.4), (0.48, 0.48, 0.47), (0.52, 0.52, 0.51))),
    "felt": Paint(colors=((0.05, 0.008, 0.01), (0.12, 0.02, 0.025), (0.2, 0.04, 0.045))),
    "books": Paint(colors=((0.02, 0.05, 0.12), (0.25, 0.08, 0.05), (0.6, 0.5, 0.3))),
    "lamp": Paint(colors=((1, 1, 1), (1, 0.95, 0.85), (1, 0.9, 0.75)), glow=6),
    "window": Paint(colors=((0.4, 0.5, 0.7), (0.75, 0.85, 1), (1, 1, 1)), glow=5),
}


def material(name: str, grain: str, *, cover: str | None = None, tinted: bool = False, image: str | None = None):
    """Blender's material of a paint with a picture of ``grain``; ``tinted`` by the attribute, over an ``image``.

    It is 1 in the pass ``cover``.
    """
    paint = PAINTS[name]
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = nodes["Principled BSDF"]
    place = nodes.new("ShaderNodeTexCoord").outputs["Object"]
    mixed = _grain(made, place, grain, paint.scale)
    color = _ramp(made, mixed, paint.colors, 0.5 - 0.3 / paint.contrast, 0.5 + 0.3 / paint.contrast)
    if paint.bricks:
        color = _product(made, color, _bricks(made, place, paint.bricks))
    if tinted:
        attribute = nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "tint"
        color = _product(made, color, attribute.outputs["Color"])
    if image is not None:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(image)
        color = _product(made, color, picture.outputs["Color"])
    links.new(color, shader.inputs["Base Color"])
    spread = nodes.new("ShaderNodeMapRange")
    low, high = paint.roughness
    for key, value in (("From Min", 0.3), ("From Max", 0.7), ("To Min", low), ("To Max", high)):
        spread.inputs[key].default_value = value
    links.new(mixed, spread.inputs["Value"])
    links.new(spread.outputs["Result"], shader.inputs["Roughness"])
    shader.inputs["Metallic"].default_value = paint.metallic
    if cover is not None:
        output = nodes.new("ShaderNodeOutputAOV")
        output.aov_name, output.inputs["Value"].default_value = cover, 1
    if paint.glow:
        links.new(color, shader.inputs["Emission Color"])
        shader.inputs["Emission Strength"].default_value = paint.glow
    return made


def _grain(made, place, image: str, scale: float):
    """A picture of noise, from three sides; Blender's own noise would take most of the time."""
    nodes, links = made.node_tree.nodes, made.node_tree.links
    move, picture = nodes.new("ShaderNodeMapping"), nodes.new("ShaderNodeTexImage")
    move.inputs["Scale"].default_value = (scale, scale, scale)
    move.inputs["Location"].default_value = (0.31, 0.17, 0.43)
    picture.image = bpy.data.images.load(image, check_existing=True)
    picture.image.colorspace_settings.name = "Non-Color"
    picture.projection, picture.projection_blend = "BOX", 0.2
    links.new(place, move.inputs["Vector"])
    links.new(move.outputs[0], picture.inputs["Vector"])
    return picture.outputs["Color"]


def write_grain(path: str, seed: int) -> None:
    """Noise that repeats at its borders, with features of all sizes, as strong in each octave but the largest."""
    chance = np.random.default_rng(seed)
    size = GRAIN_PIXELS
    waves = np.fft.rfft2(chance.normal(size=(size, size)))
    frequency = np.hypot(np.fft.fftfreq(size, 1 / size)[:, None], np.fft.rfftfreq(size, 1 / size)[None])
    waves *= np.where(frequency >= 2, np.maximum(frequency, 1) ** -GRAIN_FALL, 0)
    values = np.fft.irfft2(waves, (size, size))
    values = 0.5 + 0.15 * values / values.std()
    Image.fromarray(np.round(values.clip(0, 1) * 65535).astype(np.uint16)).save(path)


def _ramp(made, value, colors: Sequence[Color], low: float, high: float):
    nodes, links = made.node_tree.nodes, made.node_tree.links
    node = nodes.new("ShaderNodeValToRGB")
    elements = node.color_ramp.elements
    middle = elements.new(0.5)
    for element, color, position in zip((elements[0], middle, elements[2]), colors, (low, 0.5, high), strict=True):
        element.color, element.position = (*color, 1), position
    links.new(value, node.inputs["Fac"])
    return node.outputs["Color"]


def _product(made, a, b):
    nodes, links = made.node_tree.nodes, made.node_tree.links
    node = nodes.new("ShaderNodeVectorMath")
    node.operation = "MULTIPLY"
    links.new(a, node.inputs[0])
    links.new(b, node.inputs[1])
    return node.outputs["Vector"]


def _bricks(made, place, along: float):
    """Bricks and mortar over x + y and z, which lies flat on walls along either axis."""
    nodes, links = made.node_tree.nodes, made.node_tree.links
    split, join, brick = (nodes.new(f"ShaderNode{kind}") for kind in ("SeparateXYZ", "CombineXYZ", "TexBrick"))
    total = nodes.new("ShaderNodeMath")
    links.new(place, split.inputs[0])
    links.new(split.outputs["X"], total.inputs[0])
    links.new(split.outputs["Y"], total.inputs[1])
    links.new(total.outputs[0], join.inputs["X"])
    links.new(split.outputs["Z"], join.inputs["Y"])
    links.new(join.outputs[0], brick.inputs["Vector"])
    brick.inputs["Scale"].default_value = along
    brick.inputs["Mortar Size"].default_value = 0.025
    brick.inputs["Color1"].default_value = (0.7, 0.7, 0.7, 1)
    brick.inputs["Color2"].default_value = (1.3, 1.2, 1.1, 1)
    brick.inputs["Mortar"].default_value = (1.6, 4.0, 5.5, 1)
    return brick.outputs["Color"]
