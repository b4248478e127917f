"""A model house: bricks, panes in deep frames, tiles that overlap, a stepped gable, a turret."""

import numpy as np
import trimesh
from trimesh.creation import cone

from blender_captures.parts import Piece, at, block, disc, rod


def house() -> list[Piece]:
    """Its front is at -y."""
    chance = np.random.default_rng(3)
    walls = [block([1.7, 0.8, 0.8], [0, 0.15, 0.4]), block([0.62, 0.62, 0.95], [0.28, -0.38, 0.475])]
    walls += [_gable(0.8, 0.42, 1.7, [0, 0.15, 0.8], 90), _gable(0.62, 0.36, 0.62, [0.28, -0.38, 0.95], 0)]
    white, glass, slate, copper, stone = [], [], [], [], []
    holes = []
    front = [(x, -0.25, z) for x in (-0.72, -0.47, -0.22) for z in (0.24, 0.58)] + [
        (0.74, -0.25, 0.24),
        (0.74, -0.25, 0.58),
    ]
    front += [(x, -0.69, z) for x in (0.12, 0.28, 0.44) for z in (0.28, 0.6, 0.86)] + [(0.28, -0.69, 1.08)]
    for x, y, z in front:
        _window(holes, white, glass, stone, (x, y, z), 0)
    for y in (-0.05, 0.2, 0.42):
        for z in (0.24, 0.58):
            _window(holes, white, glass, stone, (-0.85, y, z), -90)
            _window(holes, white, glass, stone, (0.85, y, z), 90)
    for z in (0.3, 0.65):
        _window(holes, white, glass, stone, (-0.03, -0.45, z), -90)
        _window(holes, white, glass, stone, (0.59, -0.45, z), 90)
    brick = trimesh.boolean.difference(
        [trimesh.boolean.union(walls, engine="manifold"), trimesh.boolean.union(holes, engine="manifold")],
        engine="manifold",
    )
    slate += _tiles(chance, 0.8, 0.42, 1.74, [0, 0.15, 0.8], 90) + _tiles(
        chance, 0.62, 0.36, 0.56, [0.28, -0.38, 0.95], 0
    )
    bricks = [brick, block([0.13, 0.13, 0.42], [-0.5, 0.3, 1.2]), block([0.11, 0.11, 0.36], [0.66, 0.1, 1.2])]
    stone += [block([0.16, 0.16, 0.04], [-0.5, 0.3, 1.41]), block([0.14, 0.14, 0.04], [0.66, 0.1, 1.38])]
    stone += [disc(0.03, 0.1, [-0.53 + 0.06 * i, 0.3, 1.46], sections=24) for i in range(2)]
    # Steps of the gables, with caps.
    for k in range(7):
        for side in (-1, 1):
            x = 0.28 + side * (0.33 - 0.05 * k)
            bricks.append(block([0.055, 0.07, 0.13], [x, -0.675, 0.97 + 0.058 * k]))
            stone.append(block([0.068, 0.085, 0.016], [x, -0.675, 1.04 + 0.058 * k]))
    bricks.append(disc(0.13, 1.0, [-0.85, -0.25, 0.5], sections=64))
    stone += [disc(0.145, 0.03, [-0.85, -0.25, z], sections=64) for z in (0.08, 0.42, 0.78, 1.0)]
    roof = cone(radius=0.165, height=0.42, sections=48)
    copper += [at(roof, [-0.85, -0.25, 1.01]), rod([-0.85, -0.25, 1.4], [-0.85, -0.25, 1.55], 0.008)]
    copper += [disc(0.17 - 0.0165 * k, 0.012, [-0.85, -0.25, 1.02 + 0.042 * k], sections=48) for k in range(9)]
    for x, y in ((-0.69, -0.262), (0.86, -0.262), (-0.06, -0.262)):
        copper.append(rod([x, y, 0.03], [x, y, 0.8], 0.012, 16))
    copper.append(rod([-0.86, -0.275, 0.8], [-0.03, -0.275, 0.8], 0.02, 16))
    for z in (0.1, 0.42, 0.79):
        stone.append(block([1.73, 0.83, 0.022], [0, 0.15, z]))
        stone.append(block([0.65, 0.65, 0.022], [0.28, -0.38, z]))
    stone += [block([2.0, 1.5, 0.05], [0, -0.05, -0.02]), block([0.2, 0.12, 0.03], [-0.22, -0.3, 0.02])]
    white.append(block([0.15, 0.03, 0.3], [0.28, -0.692, 0.16]))
    for material in (white, glass, slate, copper, stone, bricks):
        assert material  # noqa: S101
    return [
        Piece(mesh=mesh, paint=paint)
        for paint, meshes in (
            ("brick", bricks),
            ("white paint", white),
            ("glass", glass),
            ("slate", slate),
            ("copper", copper),
            ("sandstone", stone),
        )
        for mesh in meshes
    ]


def _gable(width: float, height: float, depth: float, place: list[float], turn: float) -> trimesh.Trimesh:
    """A prism whose triangle stands across x, and with ``turn`` 90 across y."""
    triangle = [(-width / 2, -0.01), (width / 2, -0.01), (0, height)]
    corners = [(x, y, z) for x, z in triangle for y in (-depth / 2, depth / 2)]
    return at(trimesh.Trimesh(corners).convex_hull, place, [0, 0, turn])


def _window(holes: list, white: list, glass: list, stone: list, place: tuple[float, float, float], turn: float) -> None:
    """A hole, a pane at its bottom, a frame with bars, a sill; it looks to -y before it is turned about z."""
    wide, high, deep = 0.12, 0.2, 0.06

    def put(size: list[float], offset: list[float]) -> trimesh.Trimesh:
        return at(block(size, offset), place, [0, 0, turn])

    holes.append(put([wide, 2 * deep, high], [0, 0, 0]))
    glass.append(put([wide + 0.01, 0.02, high + 0.01], [0, deep, 0]))
    white += [put([0.016, 0.02, high], [x, deep - 0.015, 0]) for x in (-wide / 2 + 0.007, 0, wide / 2 - 0.007)]
    white += [put([wide, 0.02, 0.016], [0, deep - 0.015, z]) for z in (-high / 2 + 0.007, 0.03, high / 2 - 0.007)]
    stone.append(put([wide + 0.05, 0.05, 0.018], [0, -0.005, -high / 2 - 0.009]))
    stone.append(put([wide + 0.03, 0.02, 0.025], [0, 0.0, high / 2 + 0.012]))


def _tiles(chance, width: float, height: float, depth: float, place: list[float], turn: float) -> list[trimesh.Trimesh]:
    """Both sides of a roof over ``_gable``; rows overlap, each tile lies a little differently."""
    slope = np.degrees(np.arctan2(height, width / 2))
    length = np.hypot(height, width / 2) + 0.05
    rows, columns = round(length / 0.055), round(depth / 0.06)
    tiles = []
    for side in (-1, 1):
        for row in range(rows):
            along = length * (row + 0.5) / rows - 0.05
            x = side * (width / 2 - along * np.cos(np.radians(slope)))
            z = along * np.sin(np.radians(slope)) + 0.012
            for column in range(columns + row % 2):
                y = depth * ((column + 0.5 - 0.5 * (row % 2)) / columns - 0.5)
                if abs(y) > depth / 2:
                    continue
                size = [0.075, depth / columns * 0.97, 0.014]
                tilt = [chance.normal(0, 0.8), side * (slope - 7 + chance.normal(0, 0.8)), 0]
                tiles.append(at(block(size, [x, y, z + chance.normal(0, 0.001)], tilt), place, [0, 0, turn]))
        ridge = [rod([0, -depth / 2, height + 0.015], [0, depth / 2, height + 0.015], 0.025, 16)]
    return tiles + [at(mesh, place, [0, 0, turn]) for mesh in ridge]
