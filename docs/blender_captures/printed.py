"""A printed box and a mug."""

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from blender_captures.parts import Piece, at, block, bow, revolved

WORDS = ("oats", "barley", "honey", "crisp", "whole grain", "500 g", "best before", "see lid", "keep dry", "no sugar")


def box_and_mug() -> list[Piece]:
    """A carton with print on all sides, a mug that is open above, with a handle."""
    chance = np.random.default_rng(41)
    carton = _carton([0.62, 0.34, 0.95])
    carton.apply_transform(trimesh.transformations.euler_matrix(0, 0, 0.35))
    carton.apply_translation([-0.3, 0.22, 0.475])
    carton.visual = TextureVisuals(uv=carton.visual.uv, material=SimpleMaterial(image=_label(chance, 900, 1100)))
    mug = revolved(_mug_profile(), 160)
    mug.apply_translation([0.42, -0.2, 0])
    mug.visual = TextureVisuals(uv=mug.visual.uv, material=SimpleMaterial(image=_band(chance, 1600, 600)))
    handle = at(bow((0.15, 0.17), (0.026, 0.034), reach=0.235), [0.42, -0.2, 0.27], [0, 0, np.degrees(-0.9)])
    coaster = block([0.62, 0.62, 0.03], [0.42, -0.2, -0.012], [0, 0, 12])
    return [
        Piece(mesh=carton, paint="print"),
        Piece(mesh=mug, paint="glaze"),
        Piece(mesh=handle, paint="glaze"),
        Piece(mesh=coaster, paint="wood"),
    ]


def _carton(size: list[float]) -> trimesh.Trimesh:
    """Six sides of their own vertices; each takes a tile of a 3 x 2 sheet."""
    vertices, faces, coordinates = [], [], []
    for side in range(6):
        axis, sign = side // 2, 1 - 2 * (side % 2)
        other, up = [a for a in range(3) if a != axis]
        for corner, (u, v) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            point = np.zeros(3)
            point[axis], point[up] = sign * size[axis] / 2, size[up] * (v - 0.5)
            # Outside, print is read from left to right.
            mirror = sign if axis != 1 else -sign
            point[other] = mirror * size[other] * (u - 0.5)
            vertices.append(point)
            coordinates.append([(side % 3 + u) / 3, (side // 3 + v) / 2])
            del corner
        a = 4 * side
        faces += [[a, a + 1, a + 2], [a, a + 2, a + 3]]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual = TextureVisuals(uv=np.array(coordinates))
    return mesh


def _mug_profile() -> np.ndarray:
    """Radius and height, from the middle of the foot outside up and inside down."""
    rounding = np.linspace(0, np.pi, 12)
    lip = np.stack([0.2325 + 0.0125 * np.cos(rounding), 0.55 + 0.0125 * np.sin(rounding)], axis=1)
    outside = [[0, 0], [0.2, 0], [0.228, 0.012], [0.24, 0.04], *([0.245, z] for z in np.linspace(0.07, 0.54, 24))]
    inside = [*([0.22, z] for z in np.linspace(0.54, 0.06, 24)), [0.2, 0.035], [0.0, 0.03]]
    return np.array([*outside, *lip, *inside])


def _label(chance: np.random.Generator, width: int, height: int) -> Image.Image:
    """A 3 x 2 sheet of sides."""
    sheet = Image.new("RGB", (3 * width, 2 * height))
    for side in range(6):
        ground = tuple(int(v) for v in chance.integers((170, 90, 30), (240, 180, 120)))
        face = Image.new("RGB", (width, height), ground)
        draw = ImageDraw.Draw(face)
        for _ in range(40):
            x, y, size = chance.integers(0, width), chance.integers(0, height), int(chance.integers(10, 70))
            color = tuple(int(v) for v in chance.integers(40, 250, 3))
            draw.ellipse([x, y, x + size, y + size * 0.6], fill=color, outline=(60, 30, 10))
        draw.rectangle([60, 90, width - 60, 330], fill=(40, 60, 110), outline=(240, 220, 160), width=8)
        draw.text((110, 130), "MORNING\nOATS", font=ImageFont.load_default(95), fill=(250, 240, 210))
        for k in range(22):
            line = " ".join(chance.choice(WORDS, 7))
            draw.text((70, 400 + 26 * k), line, font=ImageFont.load_default(22), fill=(30, 25, 20))
        for k, bar in enumerate(chance.integers(2, 9, 40)):
            draw.rectangle([540 + 7 * k, height - 130, 540 + 7 * k + int(bar) // 2, height - 30], fill=(10, 10, 10))
        sheet.paste(face, ((side % 3) * width, (side // 3) * height))
    return sheet


def _band(chance: np.random.Generator, width: int, height: int) -> Image.Image:
    """Flowers and stripes around a mug; the uppermost row of pixels is the inside's."""
    image = Image.new("RGB", (width, height), (236, 232, 222))
    draw = ImageDraw.Draw(image)
    for y in (60, 80, 500, 520):
        draw.rectangle([0, y, width, y + 8], fill=(40, 70, 140))
    for _ in range(90):
        x, y, size = chance.uniform(0, width), chance.uniform(120, 470), chance.uniform(12, 36)
        color = tuple(int(v) for v in chance.integers((120, 20, 40), (230, 120, 160)))
        for turn in np.linspace(0, 2 * np.pi, 6)[:5]:
            u, v = x + size * np.cos(turn), y + size * np.sin(turn)
            draw.ellipse([u - size / 2, v - size / 2, u + size / 2, v + size / 2], fill=color)
        draw.ellipse([x - size / 3, y - size / 3, x + size / 3, y + size / 3], fill=(240, 200, 60))
        draw.line([x, y + size, x + 9, y + 3 * size], fill=(40, 110, 50), width=4)
    return image
