"""What of a reference the training cameras see, and distances over that part alone.

No method can know a surface that no photograph shows. Distances over all of the surface, ours by default, count what it
made up there; these leave it out, as some benchmarks do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.types import Box, Camera

_SLACK = 1e-4
"""Share of the bounding box's diagonal by which a ray may be blocked before its point and the point still be seen: a
point on a face must not be hidden by the rounding of that face or of the one beside it."""

_WALL = 0.02
"""Share of a box's longest side from its walls within which a surface that goes on beyond it is not compared."""


@dataclass(frozen=True, kw_only=True)
class VisibleDistances:
    """Distances between a result A and the part of a reference B that is seen; scene units, N samples each way.

    ``accuracy`` is the mean over A's samples whose nearest sample of B is seen, ``completeness`` over B's seen samples,
    ``point_to_surface`` the mean of the two, ``median`` the mean of both medians. ``normal_error`` is the angle between
    the face of a sample and that nearest to it, mean of both directions, in degrees from 0 to 90. Infinite where there
    is nothing to take a mean of.
    """

    point_to_surface: float
    median: float
    normal_error: float
    accuracy: float
    completeness: float
    seen_share: float
    """Of the reference's area, in [0, 1], to the error of sampling."""


def seen_by(surface: MeasuredMesh, cameras: Sequence[Camera], least: int = 1) -> Bool[np.ndarray, " n"]:
    """Which of a surface's own samples at least so many cameras see: in the image, in front, nothing in between.

    Cameras are in the frame of the surface. The surface need not be closed or oriented.
    """
    return points_seen(surface, surface.samples.points, cameras, least)


def points_seen(
    surface: MeasuredMesh, points: Float64[np.ndarray, "n 3"], cameras: Sequence[Camera], least: int = 1
) -> Bool[np.ndarray, " n"]:
    """The same for points on the surface."""
    seeing = np.zeros(len(points), dtype=np.int32)
    slack = _SLACK * surface.mesh.diagonal
    for camera in cameras:
        candidates = np.flatnonzero(seeing < least)
        candidates = candidates[_in_image(points[candidates], camera)]
        origin = camera.position.double().numpy()
        ways = points[candidates] - origin
        reached = surface.first_hits(np.broadcast_to(origin, ways.shape), ways) * np.linalg.norm(ways, axis=1)
        seeing[candidates] += reached >= np.linalg.norm(ways, axis=1) - slack
    return seeing >= least


@dataclass(frozen=True, kw_only=True, eq=False)
class Observed:
    """What photographs that cut an object off can be asked for: what cameras see, away from the box's walls, where a
    closed surface has to end."""

    cameras: Sequence[Camera]
    box: Box
    """World frame, as the cameras."""
    least: int = 1
    """Cameras that must see a place of the result: what one sees alone may be at any depth."""

    def inside(self, points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        low, high = self.box.minimum.double().numpy(), self.box.maximum.double().numpy()
        margin = _WALL * (high - low).max()
        return ((points > low + margin) & (points < high - margin)).all(axis=1)


def visible_distances(
    result: Mesh,
    reference: MeasuredMesh,
    seen: Bool[np.ndarray, " n"],
    *,
    observed: Observed | None = None,
    seed: int = 0,
) -> VisibleDistances:
    """Measure ``result`` against the seen samples of ``reference``; it is sampled as ``chamfer`` does.

    With ``observed``, of both only what it holds, and of the result only what its cameras see of it.
    """
    if observed is not None:
        seen = seen & observed.inside(reference.samples.points)
    share = float(seen.mean())
    if not result.areas.sum() > 0 or not seen.any():
        nothing = np.inf
        return VisibleDistances(
            point_to_surface=nothing, median=nothing, normal_error=nothing, accuracy=nothing, completeness=nothing,
            seen_share=share,
        )  # fmt: skip
    measured = MeasuredMesh(result, len(seen), seed + 1)
    chosen = seen[reference.nearest_samples(measured.samples.points)]
    if observed is not None:
        chosen &= observed.inside(measured.samples.points) & seen_by(measured, observed.cameras, observed.least)
    there, back = _compared(measured, chosen, reference), _compared(reference, seen, measured)
    return VisibleDistances(
        point_to_surface=0.5 * (there.mean + back.mean),
        median=0.5 * (there.median + back.median),
        normal_error=0.5 * (there.angle + back.angle),
        accuracy=there.mean,
        completeness=back.mean,
        seen_share=share,
    )


@dataclass(frozen=True, kw_only=True)
class _OneWay:
    mean: float
    median: float
    angle: float


def _compared(source: MeasuredMesh, chosen: Bool[np.ndarray, " n"], target: MeasuredMesh) -> _OneWay:
    """From the chosen samples of one surface to the other."""
    if not chosen.any():
        return _OneWay(mean=np.inf, median=np.inf, angle=np.inf)
    squared, face = target.squared_distances(source.samples.points[chosen])
    distances = np.sqrt(squared)
    cosine = np.abs(np.einsum("ij,ij->i", source.samples.normals[chosen], target.unit_normals(face)))
    return _OneWay(
        mean=float(distances.mean()),
        median=float(np.median(distances)),
        angle=float(np.degrees(np.arccos(cosine.clip(0, 1))).mean()),
    )


def _in_image(points: Float64[np.ndarray, "n 3"], camera: Camera) -> Bool[np.ndarray, " n"]:
    return camera.shows(camera.project(points))
