"""The planes that an object stands on or before, among points with normals on both: a table, the wall behind it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

Points = Float64[np.ndarray, "n 3"]

_GUESSES, _SAMPLE = 600, 20_000
"""Planes that are tried, and points that they are tried on."""
_FITTED, _FITS = 20, 5
"""Of these the best by points on them, and by those less the ones below, are fitted to the points on them, so often."""
_THICK, _ALIGNED = 0.015, 0.8
"""A point is on the plane within this distance, in units of ``reach``, and from this cosine between the normals on."""
_PLANES = 3
"""That are looked for at most: a table in the corner of a room."""
_SHARE, _BELOW = 0.08, 0.6
"""Of the points a plane must hold at least, and what may lie below it beside what lies on it: seldom is there much to
be seen under a table."""
_DIRECTIONS, _ALL, _OVER = 24, 0.95, 1.03
"""In so many directions around the object, the plane must go on beyond it: by this factor in this share of them."""
_HIGH = 6
"""Times the thickness of the plane above it from which on points are the object's, which may reach over its edge."""
_EXTREME = 98
"""Percentile that stands for how far points reach in a direction."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plane:
    normal: Float64[np.ndarray, " 3"]
    """Unit, to the side the object is on."""
    point: Float64[np.ndarray, " 3"]

    def height(self, points: Points) -> Float64[np.ndarray, " n"]:
        return (points - self.point) @ self.normal

    def holds(self, points: Points, reach: float) -> Bool[np.ndarray, " n"]:
        """Which points are on it, where ``reach`` is half the side of the cube that holds the object."""
        return np.abs(self.height(points)) < _THICK * reach


def find_planes(points: Points, normals: Points, reach: float) -> list[Plane]:
    """Planes that many of the points around the origin's neighbourhood lie on and almost none below, the largest first.

    ``reach`` is half the side of the cube around the origin that holds the object; ``normals`` are unit, to the side
    that is seen. Each plane is looked for among the points above the former ones.
    """
    near = np.abs(points).max(axis=1, initial=0.0) < reach
    if near.sum() < _DIRECTIONS:
        return []
    chance = np.random.default_rng(0)
    chosen = chance.permutation(np.flatnonzero(near))[:_SAMPLE]
    points, normals, thick = points[chosen], normals[chosen], _THICK * reach
    planes: list[Plane] = []
    while len(planes) < _PLANES and len(points) >= _DIRECTIONS:
        plane = _best(points, normals, thick, chance)
        heights = plane.height(points)
        on = (np.abs(heights) < thick) & (normals @ plane.normal > _ALIGNED)
        below = (heights < -2 * thick).sum()
        if on.sum() < _SHARE * len(chosen) or below > _BELOW * on.sum():
            break
        planes.append(plane)
        points, normals = points[heights > 2 * thick], normals[heights > 2 * thick]
    return planes


def goes_on(plane: Plane, points: Points, standing: Float64[np.ndarray, "m 3"], reach: float) -> bool:
    """Whether the points on a plane reach farther than the points of what is ``standing`` on it, seen from the middle
    of these: else it is a part of the object, which lies on a brick."""
    above = standing[plane.height(standing) > _HIGH * _THICK * reach]
    if len(above) < _DIRECTIONS:
        return False
    on = points[plane.holds(points, reach)]
    across = np.linalg.svd(plane.normal[None])[2][1:]
    turn = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    ways = across.T @ np.stack([np.cos(turn), np.sin(turn)])
    middle = np.median(above, axis=0)
    object_reach = np.percentile((above - middle) @ ways, _EXTREME, axis=0)
    plane_reach = np.percentile((on - middle) @ ways, _EXTREME, axis=0)
    return bool((plane_reach > _OVER * object_reach).mean() >= _ALL)


def _best(points: Points, normals: Points, thick: float, chance: np.random.Generator) -> Plane:
    """Of the planes through single points, fitted to those on them, the one with most points on it and fewest below."""

    def held(plane: Plane) -> tuple[int, float, Bool[np.ndarray, " n"]]:
        heights = plane.height(points)
        on = (np.abs(heights) < thick) & (normals @ plane.normal > _ALIGNED)
        return int(on.sum()), float(on.sum() - 2.0 * (heights < -2 * thick).sum()), on

    def fitted(plane: Plane) -> Plane:
        for _ in range(_FITS):
            many, _, on = held(plane)
            if many < 3:
                break
            middle = points[on].mean(axis=0)
            normal = np.linalg.svd(points[on] - middle, full_matrices=False)[2][2]
            plane = Plane(normal=normal * (1.0 if normal @ plane.normal >= 0 else -1.0), point=middle)
        return plane

    guesses = [Plane(normal=normals[i], point=points[i]) for i in chance.integers(len(points), size=_GUESSES)]
    scores = [held(guess)[:2] for guess in guesses]
    # By the normal of one point a table is tilted, and a part of it lies below: not to be told before it is fitted.
    promising = {i for by in (0, 1) for i in sorted(range(_GUESSES), key=lambda i: -scores[i][by])[:_FITTED]}
    return max((fitted(guesses[i]) for i in sorted(promising)), key=lambda plane: held(plane)[1])
