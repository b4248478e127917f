"""How far one surface is from another.

Definitions, for a result A and a reference B, with N area-uniform samples a_i on A and b_i on B:

    accuracy            mean_i d(a_i, B): what is there and should not be, or is in the wrong place
    completeness        mean_i d(b_i, A): what should be there and is missing
    point_to_surface    (accuracy + completeness) / 2, our Chamfer distance
    point_to_point      the same with the distance to the nearest *sample* of the other surface, as most papers have it

d(p, S) is the exact distance from a point to the nearest point of the nearest triangle. All are lengths in the units of
the scene. ``*_squared`` takes d^2 in place of d (units squared); some papers add the two directions instead of taking
their mean, which doubles every figure.

Sampling floor: point-to-surface distances of a surface to itself are 0; what is left is the statistical error of the
mean, ``point_to_surface_error``. Point-to-point distances have a floor: two samplings of the *same* surface of area S
lie about 0.5 sqrt(S / N) apart, ``point_to_point_floor``, 0.004 for a unit sphere and N = 200 000.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.face_search import FaceSearch
from sculpt_framework.evaluation.mesh import Mesh, load_mesh

RELATIVE_THRESHOLDS = (0.001, 0.002, 0.005, 0.01)
"""F-score thresholds as shares of the diagonal of the reference's bounding box."""
ABSOLUTE_THRESHOLDS = (0.002, 0.005, 0.01, 0.02)
"""F-score thresholds in scene units."""
CURVE_THRESHOLD = 0.002
"""The relative threshold of the one F-score in curve.csv: near the error of a good reconstruction, so that it tells."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceSamples:
    """Points on a mesh, with the face each lies on and that face's unit normal. Ordered by face."""

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    face: Int64[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class ChamferResult:
    """Distances between a result and a reference; see the module for every definition.

    A result without area has nothing to measure: its distances are infinite and its scores 0.
    """

    point_to_surface: float
    accuracy: float
    completeness: float
    point_to_surface_squared: float
    point_to_point: float | None
    """This and its companions are None where they were not asked for."""
    point_to_point_accuracy: float | None
    point_to_point_completeness: float | None
    point_to_point_squared: float | None
    normal_consistency: float
    """Mean over both directions of |n(sample) . n(nearest point)|, 1 is best; blind to orientation by intent."""
    fscore_relative: Mapping[float, float]
    """Harmonic mean of precision and recall per share of the reference's diagonal, in [0, 1]. Precision is the share
    of the result's samples nearer than the threshold to the reference, recall the share of the reference's."""
    fscore_absolute: Mapping[float, float]
    """The same per threshold in scene units."""
    point_to_surface_error: float
    """Standard error of ``point_to_surface`` from sampling, an upper estimate."""
    point_to_point_floor: float
    """What ``point_to_point`` is, about, between two samplings of the reference itself."""
    reference_diagonal: float
    """Diagonal of the reference's bounding box."""
    samples: int
    """Samples on each surface."""

    @property
    def fscore(self) -> float:
        """The F-score of curve.csv, at ``CURVE_THRESHOLD`` of the reference's diagonal."""
        return self.fscore_relative[CURVE_THRESHOLD]


def sample_surface(mesh: Mesh, samples: int, seed: int) -> SurfaceSamples:
    """Points uniform in area, reproducible from the seed. Raises ValueError for a mesh without area.

    Positions along the cumulative area are stratified (one in each of ``samples`` equal pieces): uniform as independent
    draws are, but every part of the surface gets its share of the samples to within one.
    """
    area_vectors = mesh.area_vectors
    areas = np.linalg.norm(area_vectors, axis=1)
    total = areas.sum()
    if not total > 0:
        raise ValueError("a mesh without area cannot be sampled")
    generator = np.random.default_rng(seed)
    position = (np.arange(samples) + generator.random(samples)) * (total / samples)
    face = np.searchsorted(np.cumsum(areas), position, side="right")
    # Rounding of the last cumulative sum must not choose a face that is not there or has no area.
    face = np.minimum(face, np.flatnonzero(areas)[-1])
    across, along = np.sqrt(generator.random(samples)), generator.random(samples)
    weights = np.stack([1 - across, across * (1 - along), across * along], axis=1)
    points = np.einsum("nc,ncx->nx", weights, mesh.vertices[mesh.faces[face]])
    return SurfaceSamples(points=points, normals=area_vectors[face] / areas[face, None], face=face)


class MeasuredMesh:
    """A mesh with what measuring needs: samples, and search trees that are built once and then reused."""

    def __init__(self, mesh: Mesh, samples: int = 200_000, seed: int = 0):
        """Faces without area are set aside: they add nothing to a surface. Raises ValueError if all are."""
        areas = mesh.areas
        self.mesh = mesh if (areas > 0).all() else Mesh(vertices=mesh.vertices, faces=mesh.faces[areas > 0])
        self.area = float(areas.sum())
        self._search = FaceSearch(self.mesh)
        self.samples = sample_surface(self.mesh, samples, seed)

    def with_samples(self, samples: int, seed: int = 0) -> "MeasuredMesh":
        """The same mesh, what searches it shared, with other samples."""
        other = copy(self)
        other.__dict__.pop("_sample_tree", None)
        other.samples = sample_surface(self.mesh, samples, seed)
        return other

    @cached_property
    def diagonal(self) -> float:
        """Of the bounding box."""
        return self.mesh.diagonal

    @cached_property
    def _sample_tree(self) -> KDTree:
        return KDTree(self.samples.points)

    def squared_distances(
        self, points: Float64[np.ndarray, "n 3"]
    ) -> tuple[Float64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
        """Exact squared distance of each point to the surface, and the nearest face."""
        return self._search.squared_distances(points)

    def sample_distances(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        """Distance of each point to the nearest sample."""
        return self._sample_tree.query(points, workers=-1)[0]

    def nearest_samples(self, points: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
        """Which of the samples is nearest to each point."""
        return np.asarray(self._sample_tree.query(points, workers=-1)[1], dtype=np.int64)

    def first_hits(
        self, origins: Float64[np.ndarray, "n 3"], ways: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, " n"]:
        """Where each ray first meets the surface, in lengths of its ``ways``; infinite where it never does."""
        return self._search.first_hits(origins, ways)

    def unit_normals(self, face: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        corners = self.mesh.vertices[self.mesh.faces[face]]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross / np.linalg.norm(cross, axis=1, keepdims=True)


def measured_file(path: Path, samples: int) -> MeasuredMesh:
    """A mesh to compare with. Raises DataError for a file that holds none, or none with an area."""
    try:
        return MeasuredMesh(load_mesh(path), samples)
    except ValueError as error:
        raise DataError(f"{path} cannot be compared with: all its faces have area 0") from error


@dataclass(frozen=True, kw_only=True, eq=False)
class _OneWay:
    """From the samples of one surface to the other: distances to the surface, agreement of normals, and distances to
    its samples where they were asked for."""

    distance: Float64[np.ndarray, " n"]
    cosine: Float64[np.ndarray, " n"]
    to_samples: Float64[np.ndarray, " n"] | None


def _one_way(source: MeasuredMesh, target: MeasuredMesh, point_to_point: bool) -> _OneWay:
    points = source.samples.points
    squared, face = target.squared_distances(points)
    return _OneWay(
        distance=np.sqrt(squared),
        cosine=np.abs(np.sum(source.samples.normals * target.unit_normals(face), axis=1)),
        to_samples=target.sample_distances(points) if point_to_point else None,
    )


def chamfer(
    result: Mesh,
    reference: Mesh | MeasuredMesh,
    *,
    samples: int = 200_000,
    seed: int = 0,
    point_to_point: bool = True,
) -> ChamferResult:
    """Measure ``result`` against ``reference``; both in the same frame and units.

    ``reference`` may be prepared once as a ``MeasuredMesh`` and used for many results; its own samples are then used,
    and ``samples`` should be their number. Two surfaces never share random numbers: the result is sampled with
    ``seed + 1``, so that comparing a mesh with itself shows the true floor of the point-to-point variants. Those can be
    left out: they take seconds where many samples are about as far as the nearest, as seen from inside a sphere.

    A result without area gives infinite distances and scores of 0. Raises ValueError if the reference has no area.
    """
    if not isinstance(reference, MeasuredMesh):
        reference = MeasuredMesh(reference, samples, seed)
    if not result.areas.sum() > 0:
        nowhere, never = np.array([np.inf]), np.zeros(1)
        way = _OneWay(distance=nowhere, cosine=never, to_samples=nowhere if point_to_point else None)
        return _summary(way, way, reference, samples)
    measured = MeasuredMesh(result, samples, seed + 1)
    there, back = _one_way(measured, reference, point_to_point), _one_way(reference, measured, point_to_point)
    return _summary(there, back, reference, samples)


def _summary(there: _OneWay, back: _OneWay, reference: MeasuredMesh, samples: int) -> ChamferResult:
    """Means over both directions; ``there`` is from the result to the reference."""
    diagonal = reference.diagonal

    def score(threshold: float) -> float:
        precision, recall = np.mean(there.distance < threshold), np.mean(back.distance < threshold)
        return float(2 * precision * recall / (precision + recall)) if precision + recall > 0 else 0.0

    accuracy, completeness = float(there.distance.mean()), float(back.distance.mean())
    accuracy_pp = completeness_pp = point_to_point = point_to_point_squared = None
    if there.to_samples is not None and back.to_samples is not None:
        accuracy_pp, completeness_pp = float(there.to_samples.mean()), float(back.to_samples.mean())
        point_to_point = 0.5 * (accuracy_pp + completeness_pp)
        point_to_point_squared = 0.5 * float(np.mean(there.to_samples**2) + np.mean(back.to_samples**2))
    return ChamferResult(
        point_to_surface=0.5 * (accuracy + completeness),
        accuracy=accuracy,
        completeness=completeness,
        point_to_surface_squared=0.5 * float(np.mean(there.distance**2) + np.mean(back.distance**2)),
        point_to_point=point_to_point,
        point_to_point_accuracy=accuracy_pp,
        point_to_point_completeness=completeness_pp,
        point_to_point_squared=point_to_point_squared,
        normal_consistency=0.5 * float(there.cosine.mean() + back.cosine.mean()),
        fscore_relative={share: score(share * diagonal) for share in RELATIVE_THRESHOLDS},
        fscore_absolute={threshold: score(threshold) for threshold in ABSOLUTE_THRESHOLDS},
        point_to_surface_error=0.5 * (_variance_of_mean(there) + _variance_of_mean(back)) ** 0.5,
        point_to_point_floor=0.5 * (reference.area / len(reference.samples.points)) ** 0.5,
        reference_diagonal=diagonal,
        samples=samples,
    )


def _variance_of_mean(way: _OneWay) -> float:
    """Of independent draws; stratified ones, as ours, vary a little less. Infinite where distances are."""
    if not np.isfinite(way.distance).all():
        return np.inf
    return float(np.var(way.distance)) / len(way.distance)
