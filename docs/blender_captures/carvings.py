"""Objects given by signed distance: a skull, a head, a relief, a pot, a statue, a cape. They are in the unit ball."""

from collections.abc import Callable

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from blender_captures.parts import Piece, without_crumbs
from sculpt_framework.demo_scenes.distance import (
    Points,
    Values,
    box,
    capsule,
    disc,
    length,
    ring,
    smooth_difference,
    smooth_union,
    sphere,
)
from sculpt_framework.demo_scenes.reference import reference_mesh

CELLS = 190
"""Along the diameter: half a pixel to two of the pictures to a face."""


def skull() -> list[Piece]:
    """Plaster, plain but for its teeth, with deep sockets."""
    return [_piece(_skull, "plaster")]


def head() -> list[Piece]:
    """Bronze: furrows down the face as on heads from Ife, curls, bands around the neck; gold is rubbed free."""
    return [_piece(_head, "bronze", _rubbed)]


def relief() -> list[Piece]:
    """A carved slab: a rosette, scrolls, a frame of beads."""
    return [_piece(_relief, "carved stone", _dusty)]


def pot() -> list[Piece]:
    """Deep and open, painted, with two handles."""
    return [_piece(_pot, "clay", _painted_bands)]


def statue() -> list[Piece]:
    """A draped figure of plaster on a plinth."""
    return [_piece(_statue, "old plaster")]


def plain_statue() -> list[Piece]:
    """The same of one colour: there is nothing on it by which photographs could be laid over each other."""
    return [_piece(_statue, "plain")]


def cape() -> list[Piece]:
    """A thin shell of gold, open above and below, with rows of bosses."""
    return [_piece(_cape, "gold", _grimy)]


def trunk() -> list[Piece]:
    """A tree with bark and roots, into which a face is cut; taller than photographs of the face show."""
    return [_piece(_trunk, "bark", _weathered)]


def fox() -> list[Piece]:
    """A stuffed fox with ears thinner than a finger, on its chest."""
    return [_piece(_fox, "fur", _red_and_white)]


def _piece(
    distance: Callable[[Points], Values], paint: str, tint: Callable[[Points], np.ndarray] | None = None
) -> Piece:
    vertices, faces = reference_mesh(distance, CELLS)
    mesh = without_crumbs(trimesh.Trimesh(vertices, faces, process=False))
    return Piece(mesh=mesh, paint=paint, tint=tint(np.asarray(mesh.vertices).T) if tint else None)


def waves(p: Points, size: float, seed: int, count: int = 12) -> Values:
    """Irregular, between -1 and 1 for the most part; ``size`` is a wave's length, so the slope is some 6 / ``size``."""
    chance = np.random.default_rng(seed)
    ways = Rotation.random(count, random_state=chance).as_matrix()[:, 0] * (2 * np.pi / size)
    ways = ways * chance.uniform(0.7, 1.4, (count, 1))
    phases = chance.uniform(0, 2 * np.pi, count)
    return sum(np.sin(way @ p + phase) for way, phase in zip(ways, phases, strict=True)) / np.sqrt(count)


def _mirrored(p: Points) -> Points:
    return np.stack([np.abs(p[0]), p[1], p[2]])


def _skull(p: Points) -> Values:
    q = _mirrored(p)
    bone = smooth_union(sphere(q, (0, 0.16, 0.3), 0.56), sphere(q, (0, -0.12, 0.3), 0.52), 0.2)
    bone = smooth_union(bone, capsule(q, (0.0, -0.4, 0.0), (0.0, -0.42, -0.3), 0.24), 0.18)
    bone = smooth_union(bone, capsule(q, (0.1, -0.58, 0.24), (0.3, -0.48, 0.22), 0.08), 0.08)
    bone = smooth_union(bone, capsule(q, (0.24, -0.52, -0.1), (0.44, -0.2, -0.02), 0.065), 0.08)
    bone = smooth_union(bone, capsule(q, (0.44, -0.2, -0.02), (0.48, 0.1, 0.0), 0.05), 0.06)
    jaw = smooth_union(
        capsule(q, (0.4, -0.02, -0.1), (0.34, -0.14, -0.5), 0.07),
        capsule(q, (0.34, -0.14, -0.5), (0.1, -0.56, -0.64), 0.08),
        0.06,
    )
    jaw = smooth_union(jaw, capsule(q, (0.0, -0.6, -0.63), (0.1, -0.56, -0.63), 0.1), 0.06)
    bone = smooth_union(bone, jaw, 0.04)
    bone = smooth_difference(bone, sphere(q, (0.22, -0.66, 0.07), 0.155), 0.06)
    bone = smooth_difference(bone, sphere(q, (0.24, -0.52, 0.05), 0.12), 0.04)
    bone = smooth_difference(bone, capsule(q, (0.02, -0.72, -0.06), (0.055, -0.66, -0.19), 0.05), 0.03)
    bone = smooth_difference(bone, sphere(q, (0.66, -0.3, 0.18), 0.2), 0.1)
    for k in range(5):
        angle = 0.16 + 0.24 * k
        x, y = 0.24 * np.sin(angle), -0.34 - 0.3 * np.cos(angle)
        bone = smooth_union(bone, capsule(q, (x, y, -0.36), (x, y, -0.45), 0.036), 0.008)
        bone = smooth_union(bone, capsule(q, (x, y + 0.02, -0.5), (x, y + 0.02, -0.58), 0.034), 0.008)
    return 0.55 * (bone - 0.004 * waves(p, 0.2, 1))


def _head(p: Points) -> Values:
    q = _mirrored(p)
    flesh = smooth_union(sphere(q, (0, 0.12, 0.36), 0.44), sphere(q, (0, -0.1, 0.3), 0.4), 0.2)
    flesh = smooth_union(flesh, capsule(q, (0, -0.2, 0.15), (0, -0.24, -0.12), 0.27), 0.15)
    flesh = smooth_union(flesh, capsule(q, (0, 0.02, -0.2), (0, 0.06, -0.72), 0.22), 0.1)
    flesh = smooth_union(flesh, disc(p, (0, 0.06, -0.78), 0.36, 0.08, 0.03), 0.08)
    flesh = smooth_union(flesh, capsule(q, (0.0, -0.49, 0.24), (0.0, -0.57, 0.06), 0.05), 0.07)
    flesh = smooth_union(flesh, sphere(q, (0.05, -0.53, 0.04), 0.05), 0.04)
    flesh = smooth_union(flesh, capsule(q, (0.05, -0.49, 0.29), (0.25, -0.38, 0.3), 0.035), 0.05)
    flesh = smooth_difference(flesh, sphere(q, (0.16, -0.53, 0.21), 0.09), 0.05)
    lid = length((q[0] - 0.16) / 1.5, q[1] + 0.4, (q[2] - 0.2) / 0.8) - 0.068
    flesh = smooth_union(flesh, lid, 0.015)
    for z, y in ((-0.07, -0.51), (-0.125, -0.5)):
        flesh = smooth_union(flesh, capsule(q, (0, y, z), (0.11, y + 0.05, z - 0.005), 0.034), 0.012)
    ear = smooth_difference(
        capsule(q, (0.47, 0.05, 0.26), (0.43, 0.03, 0.06), 0.07), sphere(q, (0.54, 0.01, 0.19), 0.06), 0.02
    )
    flesh = smooth_union(flesh, ear, 0.03)
    for z in (-0.34, -0.42, -0.5, -0.58):
        flesh = smooth_union(flesh, ring(p, (0, 0.05, z), 2, 0.215, 0.028), 0.015)
    furrows = 0.004 * np.sin(2 * np.pi * p[0] / 0.045) * _step(-0.14 - p[1]) * _step(0.4 - p[2]) * _step(p[2] + 0.25)
    scalp = _step(p[2] - 0.42 - 0.4 * np.maximum(-p[1], 0)) + _step(p[1] - 0.12) * _step(p[2] - 0.05)
    return 0.35 * (flesh + furrows - 0.02 * _curls(p) * np.minimum(scalp, 1))


def _step(x: Values) -> Values:
    """From 0 to 1 over a width of 0.06."""
    t = np.clip(x / 0.06 + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


def _curls(p: Points) -> Values:
    """Bumps in rows around the middle of the head."""
    x, y, z = p[0], p[1] - 0.05, p[2] - 0.33
    rise = np.arctan2(z, length(x, y))
    row = np.round(rise / 0.15)
    count = np.maximum(np.round(2 * np.pi * np.cos(0.15 * row) / 0.15), 4)
    return np.cos(np.pi * (rise / 0.15 - row)) ** 2 * (0.5 + 0.5 * np.cos(count * np.arctan2(y, x)))


def _relief(p: Points) -> Values:
    x, z = p[0], p[2]
    slab = box(p, (0, 0, 0), (0.74, 0.14, 0.6), 0.02)
    radius, turn = length(x, z), np.arctan2(z, x)
    petals = np.clip(1.2 * np.cos(4.5 * turn * 2) ** 2 - radius / 0.3, 0, 1) * _step(0.32 - radius)
    heart = np.sqrt(np.maximum(0.09**2 - radius**2, 0)) / 0.09
    rope = np.exp(-(((radius - 0.38) / 0.03) ** 2)) * (0.75 + 0.25 * np.cos(36 * turn + 60 * radius))
    carved = 0.05 * petals + 0.07 * heart + 0.045 * rope
    for i in (-1, 1):
        for j in (-1, 1):
            u, v = x - 0.52 * i, z - 0.4 * j
            far, angle = length(u, v), np.arctan2(i * v, i * u)
            scroll = np.exp(-((far / 0.14) ** 4)) * (0.5 + 0.5 * np.cos(2 * angle * i * j - 70 * far))
            carved = carved + 0.045 * scroll
    border = np.maximum(np.abs(x) - 0.66, np.abs(z) - 0.52)
    along = np.where(np.abs(x) - 0.66 > np.abs(z) - 0.52, z, x)
    beads = np.exp(-((border / 0.022) ** 2)) * (0.5 + 0.5 * np.cos(2 * np.pi * along / 0.06))
    carved = carved + 0.04 * beads + 0.04 * np.exp(-(((border - 0.05) / 0.016) ** 2))
    carved = carved + 0.035 * np.exp(-(((border + 0.05) / 0.014) ** 2))
    front = _step(-p[1] - 0.06)
    chisel = 0.004 * waves(p, 0.05, 4) + 0.004 * waves(p, 0.12, 5)
    foot = box(p, (0, 0.02, -0.64), (0.6, 0.24, 0.06), 0.02)
    return 0.22 * (np.minimum(slab - carved * front, foot) - chisel)


def _pot(p: Points) -> Values:
    far, z = length(p[0], p[1]), p[2]
    # The belly's radius over the height: a foot, a wide body, a neck, a lip.
    heights = np.array([-0.9, -0.72, -0.62, -0.2, 0.12, 0.4, 0.55, 0.68, 0.75])
    radii = np.array([0.3, 0.27, 0.3, 0.6, 0.66, 0.5, 0.4, 0.42, 0.5])
    from scipy.interpolate import PchipInterpolator

    radius = PchipInterpolator(heights, radii)(np.clip(z, -0.9, 0.75))
    outside = np.maximum(0.6 * (far - radius), np.abs(z + 0.075) - 0.82)
    inside = np.maximum(0.6 * (far - radius + 0.06), -(z + 0.68))
    grooves = 0.006 * np.cos(2 * np.pi * z / 0.05) * _step(z - 0.22) * _step(0.5 - z) + 0.003 * waves(p, 0.25, 6)
    wall = smooth_difference(outside + grooves, inside, 0.03)
    q = np.stack([np.abs(p[0]), p[1], p[2]])
    handle = ring(q, (0.52, 0, 0.4), 1, 0.17, 0.042)
    handle = np.maximum(handle, 0.6 * (radius - 0.03 - far))
    return 0.45 * smooth_union(wall, handle, 0.03)


def _statue(p: Points) -> Values:
    turn, z = np.arctan2(p[1], p[0]), p[2]
    folds = 0.028 * np.sin(9 * turn + 3 * np.sin(3 * z) + 2 * p[0]) + 0.012 * np.sin(17 * turn - 5 * z)
    robe = capsule(p, (0, 0, -0.62), (0.03, 0, -0.1), 0.27)
    robe = smooth_union(robe, capsule(p, (0.03, 0.0, -0.05), (0.0, 0.02, 0.3), 0.21), 0.15)
    robe = robe - folds * _step(0.25 - z)
    robe = smooth_union(robe, capsule(p, (-0.2, 0.02, 0.38), (0.2, 0.02, 0.38), 0.1), 0.12)
    body = smooth_union(robe, capsule(p, (0.0, 0.0, 0.4), (0.01, -0.03, 0.58), 0.085), 0.06)
    face = smooth_union(sphere(p, (0.01, -0.03, 0.74), 0.165), sphere(p, (0.01, -0.1, 0.66), 0.1), 0.08)
    face = smooth_union(face, capsule(p, (0.01, -0.2, 0.73), (0.01, -0.225, 0.67), 0.022), 0.03)
    for side in (-1, 1):
        face = smooth_difference(face, sphere(p, (0.01 + side * 0.065, -0.215, 0.735), 0.035), 0.025)
    hair = sphere(p, (0.01, 0.03, 0.78), 0.175) - 0.012 * np.sin(40 * p[0] + 6 * np.sin(9 * p[2])) * _step(p[1] + 0.08)
    face = smooth_union(face, hair, 0.02)
    body = smooth_union(body, smooth_union(face, sphere(p, (0.01, 0.21, 0.78), 0.09), 0.03), 0.03)
    arms = smooth_union(
        capsule(p, (-0.27, 0.0, 0.34), (-0.36, -0.08, 0.0), 0.075),
        capsule(p, (-0.36, -0.08, 0.0), (-0.08, -0.32, 0.02), 0.06),
        0.04,
    )
    raised = smooth_union(
        capsule(p, (0.27, 0.0, 0.34), (0.4, -0.1, 0.06), 0.075),
        capsule(p, (0.4, -0.1, 0.06), (0.3, -0.34, 0.3), 0.055),
        0.04,
    )
    body = smooth_union(body, smooth_union(arms, raised, 0.001), 0.04)
    body = smooth_union(body, sphere(p, (0.28, -0.38, 0.38), 0.085), 0.02)
    plinth = box(p, (0, 0, -0.9), (0.36, 0.36, 0.09), 0.015)
    return 0.3 * smooth_union(body, plinth, 0.02)


def _cape(p: Points) -> Values:
    wide, deep, z = p[0], p[1] * 1.5, p[2]
    # An oval that leans inward above, like shoulders.
    share = np.clip((z + 0.5) / 0.95, 0, 1)
    radius = 0.82 - 0.34 * share**2.2
    far, turn = length(wide, deep), np.arctan2(deep, wide)
    embossed = 0.035 * _bosses(turn * 0.75, z) + 0.012 * np.exp(-(((np.mod(z + 0.56, 0.155) - 0.0775) / 0.012) ** 2))
    sheet = 0.55 * np.abs(far - radius - embossed - 0.004 * waves(p, 0.3, 8)) - 0.014
    edge = 0.05 * np.sin(3 * turn) * 0.3
    return 0.35 * np.maximum(sheet, np.maximum(z - 0.45 - edge, -0.52 - z + edge))


def _bosses(along: Values, z: Values) -> Values:
    """Rows of round bosses, large ones and small ones in turn."""
    row = np.floor((z + 0.56) / 0.155)
    v = z + 0.56 - 0.155 * (row + 0.5)
    # The ridge is in the middle of a row; the bosses are above and below it.
    total = np.zeros_like(z)
    for height, pitch, size in ((0.045, 2 * np.pi * 0.75 / 44, 0.03), (-0.045, 2 * np.pi * 0.75 / 72, 0.019)):
        u = np.mod(along + 0.5 * pitch * row, pitch) - 0.5 * pitch
        square = (u * u + (v - height) ** 2) / size**2
        total = total + np.maximum(1 - square, 0) * size / 0.03
    return total


def _trunk(p: Points) -> Values:
    turn, z = np.arctan2(p[1], p[0]), p[2]
    far = length(p[0] - 0.04 * z, p[1])
    radius = 0.36 + 0.25 * np.exp(-(z + 0.95) / 0.22) * (0.6 + 0.4 * np.cos(5 * turn + 0.7)) + 0.02 * np.sin(2 * turn)
    wood = np.maximum(0.7 * (far - radius), np.abs(z) - 0.93)
    q = _mirrored(p)
    bare = smooth_union(sphere(q, (0, -0.16, 0.1), 0.27), sphere(q, (0, -0.13, -0.1), 0.24), 0.1)
    wood = smooth_difference(wood, sphere(q, (0.0, -0.6, 0.02), 0.34), 0.03)
    wood = smooth_union(wood, bare, 0.02)
    wood = smooth_difference(wood, sphere(q, (0.1, -0.41, 0.12), 0.065), 0.03)
    wood = smooth_union(wood, sphere(q, (0.1, -0.365, 0.115), 0.04), 0.008)
    wood = smooth_union(wood, capsule(q, (0, -0.4, 0.13), (0, -0.45, -0.02), 0.035), 0.03)
    wood = smooth_union(wood, capsule(q, (0.03, -0.4, 0.21), (0.16, -0.34, 0.2), 0.025), 0.02)
    wood = smooth_difference(wood, capsule(q, (0, -0.4, -0.12), (0.08, -0.37, -0.11), 0.022), 0.015)
    carved = np.exp(-((length(p[0], p[1] + 0.45, p[2] - 0.02) / 0.33) ** 4))
    ridges = np.abs(np.sin(11 * turn + 1.5 * waves(p, 0.35, 31))) ** 0.7
    bark = (0.03 * ridges + 0.008 * waves(p, 0.08, 32)) * (1 - carved) + 0.003 * waves(p, 0.05, 33)
    return 0.4 * (wood - bark)


def _fox(p: Points) -> Values:
    q = _mirrored(p)
    skull_ = smooth_union(sphere(q, (0, 0.0, 0.38), 0.3), capsule(q, (0.1, -0.1, 0.3), (0.2, -0.08, 0.26), 0.14), 0.12)
    snout = smooth_union(capsule(q, (0, -0.2, 0.3), (0, -0.56, 0.2), 0.09), sphere(q, (0, -0.3, 0.27), 0.14), 0.1)
    head_ = smooth_union(skull_, snout, 0.08)
    head_ = smooth_union(head_, sphere(q, (0, -0.64, 0.22), 0.05), 0.02)
    ear = np.maximum(
        0.8 * (length(q[0] - 0.2 - 0.12 * (q[2] - 0.55), 1.8 * (q[1] - 0.02)) - 0.13 + 0.32 * (q[2] - 0.6)), 0.5 - q[2]
    )
    ear = smooth_difference(ear, capsule(q, (0.2, -0.1, 0.55), (0.25, -0.06, 0.95), 0.07), 0.02)
    head_ = smooth_union(head_, ear, 0.04)
    head_ = smooth_difference(head_, sphere(q, (0.13, -0.28, 0.42), 0.05), 0.03)
    head_ = smooth_union(head_, sphere(q, (0.12, -0.25, 0.415), 0.04), 0.006)
    chest = smooth_union(
        capsule(p, (0, 0.08, 0.2), (0, 0.12, -0.4), 0.26), disc(p, (0, 0.1, -0.72), 0.42, 0.1, 0.05), 0.3
    )
    fur = 0.007 * waves(np.stack([2 * p[0], 2 * p[1], p[2]]), 0.12, 34) + 0.004 * waves(p, 0.04, 35)
    return 0.4 * (smooth_union(head_, chest, 0.15) - fur)


def _gray(values: Values) -> np.ndarray:
    return np.stack([values] * 3, axis=1)


def _rubbed(p: Points) -> np.ndarray:
    """Dark where hands do not reach, worn to gold at nose, brow, crown and in patches."""
    worn = np.exp(-((length(p[0], p[1] + 0.55, p[2] - 0.12) / 0.16) ** 2)) + _step(p[2] - 0.66) * 0.9
    worn = worn + np.clip(waves(p, 0.35, 21) - 0.4, 0, 1) + 0.35 * np.clip(waves(p, 0.04, 22), 0, 1)
    worn = np.clip(worn, 0, 1)[:, None]
    return (1 - worn) * np.array([0.1, 0.075, 0.06]) + worn * np.array([0.85, 0.55, 0.22])


def _grimy(p: Points) -> np.ndarray:
    turn = np.arctan2(p[1] * 1.5, p[0])
    raised = _bosses(turn * 0.75, p[2])
    dirt = np.clip(0.35 * waves(p, 0.25, 23) + 0.25 * waves(p, 0.03, 24) + 0.25 - 0.6 * raised, 0, 0.8)
    return _gray(1 - dirt)


def _dusty(p: Points) -> np.ndarray:
    """Dark in the deep, and lichen."""
    lichen = np.clip(2 * waves(p, 0.3, 25) + waves(p, 0.05, 26) - 1.2, 0, 1)[:, None]
    deep = _gray(np.clip(0.55 + 6 * np.maximum(-0.12 - p[1], -0.05), 0.35, 1.0))
    return deep * (1 - lichen) + lichen * np.array([0.5, 0.55, 0.25])


def _painted_bands(p: Points) -> np.ndarray:
    """Meanders and rays in black and white on red clay; the inside is plain."""
    turn, z = np.arctan2(p[1], p[0]), p[2]
    color = np.tile([0.62, 0.28, 0.13], (p.shape[1], 1))
    u, v = np.mod(turn * 14 / (2 * np.pi), 1), (z + 0.02) / 0.2
    key = (np.abs(v - 0.9) < 0.07) | ((u < 0.14) & (v > 0.1) & (v < 0.9)) | ((np.abs(v - 0.1) < 0.07) & (u < 0.7))
    key |= ((u > 0.56) & (u < 0.7) & (v > 0.1) & (v < 0.6)) | ((np.abs(v - 0.55) < 0.07) & (u > 0.3) & (u < 0.7))
    rays = (z < -0.3) & (z > -0.62) & (np.abs(u - 0.5) < 0.45 * (-0.3 - z) / 0.32)
    lines = np.cos(2 * np.pi * z / 0.036) > 0.3
    white = ((z > -0.16) & (z < -0.06) & lines) | ((z > 0.19) & (z < 0.23))
    black = (key & (v > 0) & (v < 1)) | rays | (z > 0.7) | ((z > 0.52) & (z < 0.62) & (np.cos(40 * turn) > 0))
    color[white], color[black] = [0.85, 0.78, 0.62], [0.045, 0.035, 0.03]
    # Seen from the axis: the inner face is nearer to it than the outer one.
    far = length(p[0], p[1])
    inner = _pot(np.stack([p[0] * (1 + 0.03 / far), p[1] * (1 + 0.03 / far), z])) < -0.002
    color[inner & (z < 0.69)] = [0.5, 0.25, 0.13]
    return color


def _weathered(p: Points) -> np.ndarray:
    """Grey bark with moss on one side, brighter wood where it is cut."""
    cut = np.exp(-((length(p[0], p[1] + 0.45, p[2] - 0.02) / 0.33) ** 4))[:, None]
    moss = np.clip(0.8 * waves(p, 0.4, 36) + 1.2 * p[0] - 0.3, 0, 1)[:, None]
    bark = (1 - moss) * np.array([0.2, 0.16, 0.12]) + moss * np.array([0.12, 0.2, 0.06])
    return (1 - cut) * bark + cut * np.array([0.45, 0.32, 0.2])


def _red_and_white(p: Points) -> np.ndarray:
    """Red, white at cheeks and chest, dark at nose, eyes and ears."""
    white = _step(0.24 - p[2] - 0.4 * np.abs(p[0])) * _step(-p[1] - 0.12)
    dark = _step(0.07 - length(p[0], p[1] + 0.66, p[2] - 0.22)) + _step(p[2] - 0.8)
    dark = dark + _step(0.06 - length(np.abs(p[0]) - 0.12, p[1] + 0.27, p[2] - 0.415))
    white, dark = white[:, None], np.clip(dark, 0, 1)[:, None]
    fur = (1 - white) * np.array([0.55, 0.2, 0.06]) + white * np.array([0.75, 0.7, 0.62])
    return (1 - dark) * fur + dark * np.array([0.03, 0.025, 0.02])
