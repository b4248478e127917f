"""Signed distances and ways to combine them.

Points are "3 n" (rows x, y, z, so that each is contiguous); distances are negative inside. Primitives are exact.
Combinations keep the zero set and the Lipschitz constant 1, but away from the surface may fall short of the true
distance, which costs a sphere tracer steps and never a hit. The smooth ones blend over a width ``blend``, in world
units; their gradient is a convex combination of the two gradients.
"""

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "3 n"]
Values = Float[np.ndarray, " n"]
Vector = tuple[float, float, float]


def length(*components: Values) -> Values:
    """Euclidean norm of a vector field given by its components."""
    total = components[0] * components[0]
    for component in components[1:]:
        total = total + component * component
    return np.sqrt(total)


def sphere(p: Points, center: Vector, radius: float) -> Values:
    return length(p[0] - center[0], p[1] - center[1], p[2] - center[2]) - radius


def capsule(p: Points, start: Vector, end: Vector, radius: float) -> Values:
    """All points within ``radius`` of a segment."""
    ax, ay, az = (e - s for s, e in zip(start, end, strict=True))
    x, y, z = p[0] - start[0], p[1] - start[1], p[2] - start[2]
    share = np.clip((x * ax + y * ay + z * az) / (ax * ax + ay * ay + az * az), 0, 1)
    return length(x - share * ax, y - share * ay, z - share * az) - radius


def ring(p: Points, center: Vector, axis: int, major: float, minor: float) -> Values:
    """A torus around a coordinate axis."""
    q = [p[i] - center[i] for i in range(3)]
    along = q.pop(axis)
    return length(length(*q) - major, along) - minor


def disc(p: Points, center: Vector, radius: float, half_height: float, rounding: float) -> Values:
    """A flat cylinder around z whose rim is rounded; ``radius`` and ``half_height`` include the rounding."""
    wide = length(p[0] - center[0], p[1] - center[1]) - (radius - rounding)
    high = np.abs(p[2] - center[2]) - (half_height - rounding)
    return np.minimum(np.maximum(wide, high), 0) + length(np.maximum(wide, 0), np.maximum(high, 0)) - rounding


def box(p: Points, center: Vector, half_sides: Vector, rounding: float) -> Values:
    """An axis-aligned box with rounded edges; ``half_sides`` include the rounding."""
    q = [np.abs(p[i] - center[i]) - (half_sides[i] - rounding) for i in range(3)]
    inside = np.minimum(np.maximum(np.maximum(q[0], q[1]), q[2]), 0)
    return inside + length(*(np.maximum(component, 0) for component in q)) - rounding


def smooth_union(a: Values, b: Values, blend: float) -> Values:
    near = np.maximum(blend - np.abs(a - b), 0)
    return np.minimum(a, b) - near * near * (0.25 / blend)


def smooth_difference(a: Values, b: Values, blend: float) -> Values:
    """``a`` without ``b``; the edge between them is rounded off."""
    return -smooth_union(-a, b, blend)
