"""The shapes of a mesh's triangles.

For a triangle with sides a, b, c, area S, inradius r = 2S / (a + b + c) and circumradius R = abc / 4S:

    angles          interior angles, degrees; 60 / 60 / 60 is best
    radius ratio    R / 2r, from 1 (equilateral) to infinity (no area)
    aspect ratio    longest side / (2 sqrt(3) r), from 1 (equilateral) to infinity (no area)

Both ratios are those of the Verdict library; the limits (10 degrees, ratio 4) are those of FlexiCubes' tables. Some
papers plot 2r / R, the inverse of our radius ratio.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.evaluation.mesh import Mesh

SLIVER_DEGREES = 10.0
"""A triangle whose smallest angle is below this is a sliver."""
LARGE_RATIO = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangleShapes:
    """One value per face; see the module for definitions. A face without area has angles 0, 0, 180, ratios infinity."""

    minimum_angle: Float64[np.ndarray, " f"]
    maximum_angle: Float64[np.ndarray, " f"]
    radius_ratio: Float64[np.ndarray, " f"]
    aspect_ratio: Float64[np.ndarray, " f"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Histogram:
    """Counts between consecutive edges; the last bin holds its upper edge, values beyond the edges are left out."""

    edges: Float64[np.ndarray, " e"]
    counts: Int64[np.ndarray, " b"]
    total: int
    """All values, those beyond the edges too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangleQuality:
    """Summary over all faces, every face counting the same. Means of ratios are over faces with area."""

    smallest_angle: float
    """Of the whole mesh, degrees."""
    largest_angle: float
    """Of the whole mesh, degrees."""
    mean_minimum_angle: float
    mean_maximum_angle: float
    mean_radius_ratio: float
    mean_aspect_ratio: float
    under10_pct: float
    """Percent of faces whose smallest angle is below 10 degrees."""
    radius_over4_pct: float
    aspect_over4_pct: float
    minimum_angles: Histogram
    """Smallest angle per face, bins of 2 degrees from 0 to 60."""
    maximum_angles: Histogram
    """Largest angle per face, bins of 4 degrees from 60 to 180."""
    radius_ratios: Histogram
    """Bins of 0.1 from 1 to 5."""
    aspect_ratios: Histogram
    """Bins of 0.1 from 1 to 5."""

    def summary(self) -> Mapping[str, float]:
        """The single numbers by name, for files and tables."""
        return {name: value for name, value in vars(self).items() if isinstance(value, float)}


def triangle_shapes(mesh: Mesh) -> TriangleShapes:
    """Shape measures of every face, accurate for needles too: angles come from atan2, not from a cosine near 1."""
    first, second, third = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    sides = (second - first, third - second, first - third)
    lengths = np.sqrt(np.stack([np.einsum("fx,fx->f", side, side) for side in sides]))
    double_area = 2 * mesh.areas
    scaled_cosines = np.stack([-np.einsum("fx,fx->f", sides[corner], sides[corner - 1]) for corner in range(3)])
    angles = np.degrees(np.arctan2(double_area, scaled_cosines))
    flat = double_area == 0
    safe_area = np.where(flat, 1, double_area)
    perimeter, longest = lengths.sum(0), lengths.max(0)
    inradius = safe_area / np.where(flat, 1, perimeter)
    circumradius = lengths.prod(0) / (2 * safe_area)
    return TriangleShapes(
        minimum_angle=np.where(flat, 0.0, angles.min(0)),
        maximum_angle=np.where(flat, 180.0, angles.max(0)),
        radius_ratio=np.where(flat, np.inf, circumradius / (2 * inradius)),
        aspect_ratio=np.where(flat, np.inf, longest / (2 * np.sqrt(3) * inradius)),
    )


def sliver_share(mesh: Mesh) -> float:
    """``under10_pct`` alone: percent of faces whose smallest angle is below 10 degrees. Raises ValueError for a mesh
    without faces.

    The smallest angle lies between the two longer sides a <= b and has the tangent 4S / (a^2 + b^2 - c^2).
    """
    if len(mesh.faces) == 0:
        raise ValueError("a mesh without faces has no triangle quality")
    first, second, third = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    double_area = 2 * mesh.areas
    sides = (second - first, third - first, third - second)
    squares = np.stack([np.einsum("fx,fx->f", side, side) for side in sides])
    adjacent = squares.sum(axis=0) - 2 * squares.min(axis=0)
    slivers = (2 * double_area < np.tan(np.radians(SLIVER_DEGREES)) * adjacent) | (double_area == 0)
    return 100 * float(slivers.mean())


def triangle_quality(mesh: Mesh) -> TriangleQuality:
    """Summarise the shapes of a mesh's faces. Raises ValueError for a mesh without faces."""
    if len(mesh.faces) == 0:
        raise ValueError("a mesh without faces has no triangle quality")
    shapes = triangle_shapes(mesh)

    def percent(chosen: np.ndarray) -> float:
        return 100 * float(chosen.mean())

    def finite_mean(values: np.ndarray) -> float:
        finite = values[np.isfinite(values)]
        return float(finite.mean()) if len(finite) else float("inf")

    return TriangleQuality(
        smallest_angle=float(shapes.minimum_angle.min()),
        largest_angle=float(shapes.maximum_angle.max()),
        mean_minimum_angle=float(shapes.minimum_angle.mean()),
        mean_maximum_angle=float(shapes.maximum_angle.mean()),
        mean_radius_ratio=finite_mean(shapes.radius_ratio),
        mean_aspect_ratio=finite_mean(shapes.aspect_ratio),
        under10_pct=percent(shapes.minimum_angle < SLIVER_DEGREES),
        radius_over4_pct=percent(shapes.radius_ratio > LARGE_RATIO),
        aspect_over4_pct=percent(shapes.aspect_ratio > LARGE_RATIO),
        minimum_angles=_histogram(shapes.minimum_angle, 0, 60, 30),
        maximum_angles=_histogram(shapes.maximum_angle, 60, 180, 30),
        radius_ratios=_histogram(shapes.radius_ratio, 1, 5, 40),
        aspect_ratios=_histogram(shapes.aspect_ratio, 1, 5, 40),
    )


def _histogram(values: np.ndarray, low: int, high: int, bins: int) -> Histogram:
    # Rounding puts an equilateral triangle's angles and ratios a hair outside the range they end.
    slack = 1e-9 * (high - low)
    inside = values[(values >= low - slack) & (values <= high + slack)].clip(low, high)
    counts, edges = np.histogram(inside, bins=bins, range=(low, high))
    return Histogram(edges=edges, counts=counts.astype(np.int64), total=len(values))
