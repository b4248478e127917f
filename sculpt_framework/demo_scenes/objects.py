"""The demo objects. All lie in the unit ball around the origin, z is up.

Each stands for something a reconstruction may fail on; ``summary`` says what. Edges are rounded, so that a surface
normal exists everywhere.
"""

import difflib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sculpt_framework.demo_scenes.cameras import Placement
from sculpt_framework.demo_scenes.distance import (
    Points,
    Values,
    box,
    capsule,
    disc,
    ring,
    smooth_difference,
    smooth_union,
    sphere,
)
from sculpt_framework.demo_scenes.texture import Color, SolidTexture
from sculpt_framework.errors import DataError

DEFAULT = "blob"
_COS, _SIN = float(np.cos(np.deg2rad(20))), float(np.sin(np.deg2rad(20)))


@dataclass(frozen=True, kw_only=True)
class DemoObject:
    name: str
    summary: str
    distance: Callable[[Points], Values]
    """Lower bound of the distance in absolute value, Lipschitz constant 1, zero exactly on the surface."""
    texture: SolidTexture
    genus: int
    gloss: float = 0.0
    """Brightness of the highlights of four lamps, added to the colour; 0: matt."""
    lamps_lit: tuple[int, int] | None = None
    """The lamps shine in the pictures whose number has the second as its rest when divided by the first; None: in all
    of them."""
    backdrop: Color | None = None
    """sRGB in [0, 1] of the wall behind the object, in pictures without alpha; None: pictures with alpha."""
    resolution: int = 400
    """Side of the square images in pixels, unless a user asks for another."""
    seen_from: Placement = "around"
    reference_cells: int = 128
    """Cells along the diameter of the unit ball when the reference mesh is extracted."""


def blob(p: Points) -> Values:
    body = smooth_union(sphere(p, (0.0, 0.0, -0.2), 0.58), sphere(p, (0.45, 0.12, 0.3), 0.36), 0.25)
    body = smooth_union(body, sphere(p, (-0.42, 0.3, 0.25), 0.33), 0.2)
    body = smooth_union(body, sphere(p, (-0.1, -0.55, -0.1), 0.32), 0.15)
    body = smooth_difference(body, sphere(p, (-0.1, -0.15, 0.62), 0.38), 0.06)
    return smooth_difference(body, sphere(p, (0.75, -0.35, -0.15), 0.33), 0.06)


def dents(p: Points) -> Values:
    """A ball with a dent on top and four around it, a little above the equator."""
    body = smooth_difference(
        sphere(p, (0.0, 0.0, 0.0), 0.95), capsule(p, (0.0, 0.0, 1.0), (0.0, 0.0, 0.68), 0.25), 0.06
    )
    # Turned by 20 degrees, so that nothing is aligned with the axes; then folded, so that the nearest of four is at +x.
    x, y = np.abs(_COS * p[0] + _SIN * p[1]), np.abs(_COS * p[1] - _SIN * p[0])
    folded = np.stack([np.maximum(x, y), np.minimum(x, y), p[2]])
    return smooth_difference(body, capsule(folded, (0.96, 0.0, 0.28), (0.65, 0.0, 0.19), 0.25), 0.06)


def thin(p: Points) -> Values:
    plate = disc(p, (0.0, 0.0, -0.62), 0.72, 0.03, 0.029)
    hoop = ring(p, (0.0, 0.0, 0.02), 1, 0.63, 0.045)
    body = smooth_union(plate, hoop, 0.05)
    body = smooth_union(body, capsule(p, (-0.5, -0.42, -0.62), (-0.5, -0.42, 0.35), 0.04), 0.04)
    body = smooth_union(body, capsule(p, (-0.5, -0.42, 0.35), (0.5, -0.42, 0.35), 0.03), 0.04)
    body = smooth_union(body, capsule(p, (0.5, -0.42, 0.35), (0.5, -0.42, -0.62), 0.04), 0.04)
    return smooth_union(body, box(p, (0.0, 0.42, -0.3), (0.4, 0.025, 0.33), 0.024), 0.04)


def double_torus(p: Points) -> Values:
    left, right = (ring(p, (x, 0.0, 0.0), 1, 0.4, 0.17) for x in (-0.41, 0.41))
    return smooth_union(left, right, 0.1)


def gaps(p: Points) -> Values:
    base = box(p, (0.0, 0.0, -0.5), (0.68, 0.48, 0.08), 0.04)
    pitch = 0.3
    # All five fins at once: the nearest one is found by folding space along x.
    folded = p[0] - pitch * np.clip(np.round(p[0] / pitch), -2, 2)
    fins = box(np.stack([folded, p[1], p[2]]), (0.0, 0.0, 0.0), (0.045, 0.46, 0.51), 0.04)
    body = smooth_union(base, fins, 0.05)
    return smooth_union(body, capsule(p, (-0.6, 0.0, 0.3), (0.6, 0.0, 0.3), 0.07), 0.04)


def machine(p: Points) -> Values:
    """A tracked machine of many parts: wheels, a ribbed deck, a cabin without walls, a lattice boom."""
    mirrored = np.stack([p[0], np.abs(p[1]), p[2]])
    # Five wheels on each side, a gap between any two: the nearest is found by folding space along x.
    pitch = 0.24
    folded = p[0] - pitch * np.clip(np.round(p[0] / pitch), -2, 2)
    wheels = _wheel(np.stack([folded, mirrored[1], mirrored[2]]), (0.0, 0.38, -0.42), 0.1, 0.1)
    body = smooth_union(wheels, capsule(mirrored, (-0.48, 0.38, -0.42), (0.48, 0.38, -0.42), 0.035), 0.03)
    deck = box(p, (0.0, 0.0, -0.24), (0.62, 0.34, 0.035), 0.03)
    body = smooth_union(body, smooth_union(deck, box(p, (0.0, 0.0, -0.32), (0.5, 0.1, 0.08), 0.03), 0.03), 0.02)
    body = smooth_union(body, box(mirrored, (0.0, 0.33, -0.3), (0.5, 0.03, 0.09), 0.02), 0.03)
    # Ribs of a radiator behind.
    rib = 0.11
    folded = p[0] + 0.42 - rib * np.clip(np.round((p[0] + 0.42) / rib), -1, 1)
    body = smooth_union(body, box(np.stack([folded, p[1], p[2]]), (0.0, 0.0, -0.1), (0.025, 0.26, 0.14), 0.02), 0.03)
    # A cabin: four posts and a roof over a seat.
    around = np.stack([np.abs(p[0] + 0.02), mirrored[1], p[2]])
    body = smooth_union(body, capsule(around, (0.17, 0.2, -0.2), (0.17, 0.2, 0.3), 0.025), 0.03)
    body = smooth_union(body, box(p, (-0.02, 0.0, 0.31), (0.23, 0.26, 0.03), 0.025), 0.03)
    body = smooth_union(body, box(p, (-0.04, 0.0, -0.12), (0.08, 0.11, 0.09), 0.03), 0.03)
    # Two rails and their rungs, rising to the front.
    rail = capsule(mirrored, (0.3, 0.12, -0.18), (0.85, 0.12, 0.3), 0.026)
    along, across = (0.7534, 0.6575), (-0.6575, 0.7534)
    s = along[0] * (p[0] - 0.3) + along[1] * (p[2] + 0.18) - 0.05
    n = across[0] * (p[0] - 0.3) + across[1] * (p[2] + 0.18)
    folded = s - 0.16 * np.clip(np.round(s / 0.16), 0, 4)
    rungs = capsule(np.stack([folded, p[1], n]), (0.0, -0.12, 0.0), (0.0, 0.12, 0.0), 0.02)
    return smooth_union(body, smooth_union(rail, rungs, 0.02), 0.03)


def _wheel(p: Points, center: tuple[float, float, float], radius: float, half_width: float) -> Values:
    """A flat cylinder around y."""
    turned = np.stack([p[0], p[2], p[1]])
    return disc(turned, (center[0], center[2], center[1]), radius, half_width, 0.025)


def flask(p: Points) -> Values:
    body = smooth_union(sphere(p, (0.0, 0.0, -0.3), 0.55), capsule(p, (0.0, 0.0, 0.1), (0.0, 0.0, 0.72), 0.15), 0.3)
    return smooth_union(body, ring(p, (0.0, 0.42, 0.2), 0, 0.28, 0.05), 0.05)


def pebble(p: Points) -> Values:
    return smooth_union(sphere(p, (0.12, 0.0, -0.1), 0.6), sphere(p, (-0.35, 0.1, 0.12), 0.42), 0.4)


def needle(p: Points) -> Values:
    """A body with a rod whose thickness is that of two or three cells of the finest level."""
    body = smooth_union(sphere(p, (0.0, 0.0, -0.35), 0.5), capsule(p, (0.0, 0.0, 0.1), (0.0, 0.0, 0.9), 0.022), 0.05)
    return smooth_union(body, capsule(p, (0.3, 0.0, -0.2), (0.9, 0.0, 0.1), 0.022), 0.05)


OBJECTS = {
    item.name: item
    for item in (
        DemoObject(
            name="blob",
            summary="easy: a smooth body with two shallow hollows",
            distance=blob,
            texture=SolidTexture(ground=(0.85, 0.55, 0.25), patches=(0.2, 0.45, 0.5), spots=(0.95, 0.9, 0.75), seed=11),
            genus=0,
        ),
        DemoObject(
            name="dents",
            summary="five deep dents that no silhouette shows",
            distance=dents,
            texture=SolidTexture(ground=(0.75, 0.3, 0.3), patches=(0.85, 0.75, 0.45), spots=(0.2, 0.25, 0.45), seed=21),
            genus=0,
        ),
        DemoObject(
            name="thin",
            summary="a plate, a hoop, rods and a sheet of 5 to 9 hundredths thickness",
            distance=thin,
            texture=SolidTexture(ground=(0.35, 0.6, 0.35), patches=(0.8, 0.8, 0.7), spots=(0.7, 0.25, 0.2), seed=31),
            genus=2,
        ),
        DemoObject(
            name="double-torus",
            summary="genus 2: two rings grown together",
            distance=double_torus,
            texture=SolidTexture(ground=(0.3, 0.4, 0.7), patches=(0.85, 0.6, 0.65), spots=(0.95, 0.9, 0.5), seed=41),
            genus=2,
        ),
        DemoObject(
            name="gaps",
            summary="five fins with deep gaps between them, held by a rod",
            distance=gaps,
            texture=SolidTexture(ground=(0.6, 0.5, 0.75), patches=(0.9, 0.8, 0.5), spots=(0.2, 0.4, 0.4), seed=51),
            genus=4,
        ),
        DemoObject(
            name="machine",
            summary="many parts with deep gaps, seen from above only",
            distance=machine,
            texture=SolidTexture(ground=(0.85, 0.7, 0.25), patches=(0.45, 0.45, 0.5), spots=(0.8, 0.3, 0.2), seed=61),
            genus=8,
            seen_from="above",
            reference_cells=160,
        ),
        DemoObject(
            name="flask",
            summary="shiny: highlights that move with the camera, little texture",
            distance=flask,
            texture=SolidTexture(ground=(0.25, 0.4, 0.35), patches=(0.28, 0.42, 0.4), spots=(0.22, 0.36, 0.4), seed=71),
            genus=1,
            gloss=0.6,
        ),
        DemoObject(
            name="pebble",
            summary="smooth and of one colour",
            distance=pebble,
            texture=SolidTexture(
                ground=(0.7, 0.68, 0.62),
                patches=(0.7, 0.68, 0.62),
                spots=(0.7, 0.68, 0.62),
                seed=81,
                speckle=0.0,
                grain=0.0,
            ),
            genus=0,
        ),
        DemoObject(
            name="granite",
            summary="smooth, with texture finer than the cells, in large pictures",
            distance=pebble,
            texture=SolidTexture(
                ground=(0.6, 0.58, 0.56),
                patches=(0.5, 0.46, 0.46),
                spots=(0.3, 0.28, 0.28),
                seed=91,
                speckle_wavelength=0.03,
                grain_wavelength=0.018,
                speckle=0.2,
                grain=0.25,
            ),
            genus=0,
            resolution=800,
        ),
        DemoObject(
            name="studio",
            summary="no alpha: pictures before a wall of one colour",
            distance=blob,
            texture=SolidTexture(ground=(0.85, 0.55, 0.25), patches=(0.2, 0.45, 0.5), spots=(0.95, 0.9, 0.75), seed=11),
            genus=0,
            backdrop=(0.25, 0.7, 0.35),
        ),
        DemoObject(
            name="two-faced",
            summary="five dents, texture on one side only: most views show a plain ball",
            distance=dents,
            texture=SolidTexture(
                ground=(0.75, 0.6, 0.45),
                patches=(0.85, 0.75, 0.45),
                spots=(0.2, 0.25, 0.45),
                seed=22,
                plain_beyond=-0.3,
            ),
            genus=0,
        ),
        DemoObject(
            name="flash",
            summary="matt, but for highlights in one view of ten: those that are held out",
            distance=blob,
            texture=SolidTexture(ground=(0.4, 0.35, 0.3), patches=(0.2, 0.3, 0.4), spots=(0.5, 0.4, 0.3), seed=12),
            genus=0,
            gloss=0.5,
            lamps_lit=(10, 5),
        ),
        DemoObject(
            name="needle",
            summary="two rods thinner than a coarser grid could hold, in small pictures",
            distance=needle,
            texture=SolidTexture(ground=(0.5, 0.55, 0.65), patches=(0.8, 0.75, 0.6), spots=(0.6, 0.3, 0.25), seed=101),
            genus=0,
            resolution=160,
            reference_cells=192,
        ),
    )
}


def demo_object(name: str) -> DemoObject:
    """Raises DataError, with the names there are, if there is no such object."""
    plain = name.lower().replace("_", "-")
    if plain in OBJECTS:
        return OBJECTS[plain]
    close = difflib.get_close_matches(plain, OBJECTS, n=1)
    hint = f"; did you mean {close[0]}?" if close else "."
    raise DataError(f"no demo scene is called '{name}'; there are {', '.join(OBJECTS)}{hint}")
