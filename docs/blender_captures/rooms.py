"""What stands around an object of the unit ball, and what lights it: one room for each kind of capture."""

from dataclasses import dataclass

import numpy as np
import trimesh

from blender_captures.paints import material
from blender_captures.parts import at, block, disc, rod
from blender_captures.stage import add_area_lamp, add_mesh, add_spot, sky


@dataclass(frozen=True, kw_only=True, eq=False)
class Room:
    """What has been put into a scene."""

    things: tuple
    """Everything that is hidden while masks are rendered."""
    with_camera: tuple = ()
    """Of them, what is moved as the camera is."""
    with_object: tuple = ()
    """Of them, what is turned as the object is."""


def lab(scene, floor: float, grain: str) -> Room:
    """A dark table under lamps on a frame; the arm that holds the camera stands between some of them and the object."""
    things = [_thing(scene, grain, block([9, 9, 0.1], [0, 0, floor - 0.05]), "dark cloth")]
    things.append(_thing(scene, grain, block([14, 0.1, 8], [0, 5, 3]), "dark cloth"))
    sky(scene, (1, 1, 1), 0.05)
    for azimuth, elevation, watts in ((-32, 48, 520), (24, 34, 400), (6, 72, 420), (-62, 28, 160), (64, 58, 160)):
        turn, rise = np.radians([azimuth - 90, elevation])
        way = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
        add_area_lamp(scene, 5 * way, watts, 0.12)
    # In the camera's frame, which looks along -z: its body, the wrist, and the arm that comes from one side above.
    arm = [
        block([0.34, 0.3, 0.5], [0, 0.05, 0.3]),
        rod([0, 0.1, 0.4], [0.5, 0.7, 0.2], 0.1, 24),
        rod([0.5, 0.7, 0.2], [-0.5, 1.5, -0.35], 0.12, 24),
        rod([-0.5, 1.5, -0.35], [-1.9, 1.7, -0.5], 0.16, 24),
        rod([0.1, 0.35, 0.3], [-0.6, 1.35, -0.2], 0.03, 12),
    ]
    held = [_thing(scene, grain, mesh, "dark cloth") for mesh in arm]
    for thing in held:
        # It would stand before the lens where it reaches into the picture.
        thing.visible_camera = False
    return Room(things=(*things, *held), with_camera=tuple(held))


def phone(scene, floor: float, grain: str) -> Room:
    """A table with things on it in a room with a window, a lamp and shelves."""
    chance = np.random.default_rng(31)
    meshes = [(disc(1.7, 0.08, [0, 0, floor - 0.04], sections=96), "wood")]
    meshes += [(block([12, 12, 0.1], [0, 0, floor - 2.2]), "wood"), (block([12, 12, 0.1], [0, 0, 4.5]), "wall")]
    for x, y, turn in ((0, 5, 0), (0, -5, 0), (5, 0, 90), (-5, 0, 90)):
        meshes.append((block([10, 0.1, 9], [x, y, 1], [0, 0, turn]), "wall"))
    for k in range(9):
        turn, size = 2 * np.pi * k / 9 + chance.normal(0, 0.2), chance.uniform([0.15, 0.2, 0.02], [0.4, 0.5, 0.12])
        place = [1.35 * np.cos(turn), 1.35 * np.sin(turn), floor + size[2] / 2]
        paint = ("books", "paper", "brick", "copper")[k % 4]
        meshes.append((block(size * [0.7, 0.7, 1], place, [0, 0, np.degrees(turn) + chance.normal(0, 20)]), paint))
    for side, (x, y) in enumerate(((0, 4.85), (4.85, 0), (-4.85, 0), (0, -4.85))):
        for k in range(10):
            high, along = chance.uniform(0.6, 1.6), -3.6 + 0.8 * k
            place = [x or along, y or along, floor - 1.2 + high / 2 + (k % 3) * 1.1]
            size = [0.2, 0.7, high] if x else [0.7, 0.2, high]
            meshes.append((block(size, place), ("books", "copper", "wood", "paper", "slate")[(k + side) % 5]))
    meshes.append((block([3, 0.05, 2], [-0.8, -4.9, 1.8]), "window"))
    meshes.append((block([0.05, 2.2, 1.8], [4.9, 1.2, 1.8]), "window"))
    sky(scene, (1, 1, 1), 0.15)
    add_area_lamp(scene, (-0.8, -4.6, 2.2), 420, 2.2, (0.85, 0.93, 1))
    add_area_lamp(scene, (4.6, 1.2, 2.2), 220, 1.8, (0.85, 0.93, 1))
    add_area_lamp(scene, (-1.0, 1.0, 4.2), 260, 0.5, (1, 0.83, 0.62))
    return Room(things=tuple(_thing(scene, grain, mesh, paint) for mesh, paint in meshes))


def turntable(scene, floor: float, grain: str) -> Room:
    """Grey paper behind and below, a key lamp, a soft one; the plate has marks and turns with the object."""
    meshes = [block([9, 9, 0.1], [0, 0, floor - 0.25]), block([9, 0.1, 7], [0, 3, 2])]
    still = [_thing(scene, grain, mesh, "paper") for mesh in meshes]
    still.append(_thing(scene, grain, block([0.5, 0.3, 0.9], [-1.7, 2.2, floor + 0.2], [0, 0, 20]), "books"))
    still.append(_thing(scene, grain, rod([1.6, 2.4, floor], [1.6, 2.4, 3], 0.05, 16), "slate"))
    plate = [_thing(scene, grain, disc(1.05, 0.06, [0, 0, floor - 0.03], sections=96), "white paint")]
    for k in range(24):
        turn = 2 * np.pi * k / 24
        long = 0.14 if k % 6 else 0.26
        place = [(1.02 - long / 2) * np.cos(turn), (1.02 - long / 2) * np.sin(turn), floor + 0.0005]
        plate.append(_thing(scene, grain, block([long, 0.02, 0.003], place, [0, 0, np.degrees(turn)]), "dark cloth"))
    sky(scene, (1, 1, 1), 0.12)
    add_area_lamp(scene, (-3, -2.6, 3.2), 420, 0.5, (1, 0.95, 0.88))
    add_area_lamp(scene, (3.5, -2.2, 1.5), 130, 2.5, (0.9, 0.95, 1))
    return Room(things=(*still, *plate), with_object=tuple(plate))


def museum(scene, floor: float, grain: str) -> Room:
    """A plinth in a dark hall with spot lights above, lit panels and lamps to be mirrored."""
    meshes = [
        (block([1.9, 1.9, 0.5], [0, 0, floor - 0.25]), "felt"),
        (block([14, 14, 0.1], [0, 0, floor - 1.6]), "wood"),
    ]
    for x, y, turn in ((0, 6, 0), (0, -6, 0), (6, 0, 90), (-6, 0, 90)):
        meshes.append((block([12, 0.1, 8], [x, y, 1.5], [0, 0, turn]), "slate" if x else "books"))
    for k, (x, y) in enumerate(((-3, 5.9), (2.5, 5.9), (5.9, 2), (5.9, -3), (-5.9, -1), (-2, -5.9), (3, -5.9))):
        size = [0.05, 1.1, 1.5] if abs(x) > abs(y) else [1.1, 0.05, 1.5]
        meshes.append((block(size, [x, y, 0.8 + 0.15 * k]), "window" if k % 3 == 0 else "sandstone"))
    for x, y in ((-2, -2), (2, -2), (2, 2), (-2, 2)):
        meshes.append((block([0.9, 0.25, 0.04], [x, y, 4.2], [0, 0, 45]), "lamp"))
    sky(scene, (0.7, 0.8, 1), 0.04)
    for place, watts, color in (
        ((-2.2, -2.4, 3.6), 420, (1, 0.86, 0.66)),
        ((2.6, -1.6, 3.4), 300, (1, 0.88, 0.7)),
        ((1.4, 2.8, 3.6), 340, (1, 0.9, 0.75)),
        ((-2.8, 1.6, 3.2), 260, (1, 0.84, 0.62)),
    ):
        add_spot(scene, place, (0, 0, 0), watts, 38, color)
    return Room(things=tuple(_thing(scene, grain, mesh, paint) for mesh, paint in meshes))


def forest(scene, floor: float, grain: str) -> Room:
    """Other trees, bushes and a ground of leaves under an open sky."""
    chance = np.random.default_rng(32)
    meshes = [(block([30, 30, 0.1], [0, 0, floor - 0.02]), "leaves")]
    for _ in range(26):
        turn, far = chance.uniform(0, 2 * np.pi), chance.uniform(3, 11)
        if np.cos(turn) * far < 1.5 and np.sin(turn) < -0.2:
            continue
        x, y, wide = far * np.cos(turn), far * np.sin(turn), chance.uniform(0.1, 0.4)
        meshes.append((rod([x, y, floor], [x + chance.normal(0, 0.3), y, 9], wide, 24), "wood"))
    for _ in range(22):
        turn, far = chance.uniform(-0.1, np.pi + 0.1), chance.uniform(2, 6)
        bush = trimesh.creation.icosphere(subdivisions=3, radius=chance.uniform(0.2, 0.8))
        bush.vertices *= 1 + chance.normal(0, 0.06, (len(bush.vertices), 1))
        meshes.append((at(bush, [far * np.cos(turn), far * np.sin(turn), floor + 0.1]), "leaves"))
    sky(scene, (0.75, 0.87, 1), 0.9)
    add_area_lamp(scene, (4, -5, 7), 900, 1.0, (1, 0.93, 0.8))
    return Room(things=tuple(_thing(scene, grain, mesh, paint) for mesh, paint in meshes))


def shelf(scene, floor: float, grain: str) -> Room:
    """A shelf before a wall with pictures, other things beside, a window on one side."""
    meshes = [(block([5, 1.6, 0.1], [0, 0.15, floor - 0.05]), "wood"), (block([9, 0.1, 7], [0, 1.0, 1]), "wall")]
    meshes += [(block([9, 0.1, 7], [0, -5, 1]), "wall"), (block([0.1, 7, 7], [-4, -1.5, 1]), "sandstone")]
    for x, z, wide, high, paint in ((-1.4, 0.7, 0.8, 1.0, "books"), (1.5, 0.9, 1.0, 0.7, "copper")):
        meshes.append((block([wide, 0.06, high], [x, 0.93, z]), paint))
    for x, size, paint in (
        (-1.15, (0.15, 0.5, 0.7), "books"),
        (-1.33, (0.17, 0.45, 0.6), "brick"),
        (1.2, (0.4, 0.3, 0.3), "slate"),
    ):
        meshes.append((block(size, [x, 0.4, floor + size[2] / 2], [0, 0, 8 * x]), paint))
    meshes.append((block([0.05, 2.2, 1.8], [3.9, -1.2, 1.5]), "window"))
    sky(scene, (1, 1, 1), 0.2)
    add_area_lamp(scene, (3.6, -1.4, 1.8), 330, 1.8, (0.85, 0.93, 1))
    add_area_lamp(scene, (-1.0, -2.0, 4.0), 260, 0.6, (1, 0.85, 0.65))
    return Room(things=tuple(_thing(scene, grain, mesh, paint) for mesh, paint in meshes))


def _thing(scene, grain: str, mesh: trimesh.Trimesh, paint: str):
    return add_mesh(scene, paint, mesh, material(paint, grain), smooth=True)


ROOMS = {"lab": lab, "phone": phone, "turntable": turntable, "museum": museum, "forest": forest, "shelf": shelf}
