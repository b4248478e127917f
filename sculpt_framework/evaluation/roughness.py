"""How uneven a surface is at a small scale: normals against the mean normal around them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from sculpt_framework.evaluation.geometry import sample_surface
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.types import Camera

FACING = 0.2
"""Cosine of the angle of view from which on a camera says what a place looks like."""
_AROUND = 0.03
"""Share of the surface's radius over which normals are averaged."""
_SAMPLES, _EVERY = 100_000, 10
"""Points whose normals are averaged, and which of them are looked at: some twenty points lie around each on a ball."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Unevenness:
    """Points spread evenly over a surface, with unit normals, and the angle in degrees between each point's normal and
    the mean of those around it."""

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    degrees: Float64[np.ndarray, " n"]

    def mean(self, chosen: Bool[np.ndarray, " n"]) -> float | None:
        """Mean angle over some of the points; None over none."""
        return float(self.degrees[chosen].mean()) if chosen.any() else None


def unevenness(mesh: Mesh) -> Unevenness:
    """Compare normals at points of a mesh with those around. Raises ValueError for a mesh without area.

    The radius is the root mean square distance of the surface from its middle: a sphere's own, whatever small pieces
    float about. Normals that look the other way belong to the back of something thin and do not count.
    """
    samples = sample_surface(mesh, _SAMPLES, seed=0)
    points, normals = samples.points, samples.normals
    away = points - points.mean(axis=0)
    radius = float(np.sqrt((away * away).sum(axis=1).mean()))
    tree = KDTree(points)
    looked_at = np.arange(0, len(points), _EVERY)
    around = tree.query_ball_point(points[looked_at], _AROUND * radius, workers=-1, return_sorted=False)
    counts = np.array([len(each) for each in around])
    own = np.repeat(normals[looked_at], counts, axis=0)
    others = normals[np.concatenate([np.asarray(each, np.int64) for each in around])]
    others *= (np.sum(own * others, axis=1) > 0)[:, None]
    # Each point is around itself, so that no sum is empty and none is 0.
    sums = np.add.reduceat(others, np.concatenate([[0], np.cumsum(counts)[:-1]]), axis=0)
    cosine = np.sum(sums * normals[looked_at], axis=1) / np.linalg.norm(sums, axis=1)
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return Unevenness(points=points[looked_at], normals=normals[looked_at], degrees=degrees)


def pixels_of(
    points: Float64[np.ndarray, "n 3"], camera: Camera
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Columns and rows of points that are in the camera's image."""
    columns, rows = camera.project(points).T
    # What the camera's kernel found to be inside may be on the border by another rounding.
    return np.clip(columns, 0, camera.width - 1).astype(np.int64), np.clip(rows, 0, camera.height - 1).astype(np.int64)
