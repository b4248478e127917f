"""Where the outline of rendered Gaussians lies, against the outline of the mesh they are bound to.

Offsets are in pixels of the camera, positive where the splats stand outside the mesh. The mesh's own outline is exact:
the projected edges between a face towards the camera and a face away from it, as far as no other face lies behind them.
The splats' outline is the contour alpha = 0.5 of alpha as a function of the place in the image, which a picture of one
sample per pixel holds only roughly: it is rendered finer, through the same screen filter.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.types import Camera, Gaussians

LEVEL = 0.5
"""Coverage on the outline."""
_PIECE = 0.1
"""Outlines are held as pieces at most this long, in pixels; each is all visible or all hidden."""
_ASIDE = 1e-5
"""How far beside an edge it is asked what covers it, in pixels."""
_PAIRS_AT_ONCE = 1 << 21
_NEIGHBOURS = 12
"""Pieces a point is measured against: those with the nearest middles."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouette:
    """A closed mesh on the screen, in pixels (column, row) with the first pixel's centre at 0.5."""

    triangles: Float64[np.ndarray, "t 3 2"]
    """The faces towards the camera; together they cover what the mesh covers."""
    pieces: Float64[np.ndarray, "p 2 2"]
    """Short straight pieces of the outline."""


@dataclass(frozen=True, kw_only=True)
class OutlineError:
    """Signed offsets of one or more outlines, in pixels; positive: outside the mesh."""

    mean: float
    p95: float
    """95th percentile of the absolute offset."""
    points: int

    @staticmethod
    def of(offsets: Float64[np.ndarray, " n"]) -> "OutlineError":
        """Raises ValueError where there is no offset: nothing was drawn, or everything is covered."""
        if len(offsets) == 0:
            raise ValueError("the rendering has no contour of half coverage")
        return OutlineError(
            mean=float(offsets.mean()), p95=float(np.percentile(np.abs(offsets), 95)), points=len(offsets)
        )


def outline_offsets(
    mesh: Mesh, gaussians: Gaussians, camera: Camera, rasterizer: Rasterizer, *, low_pass_px2: float, finer: int
) -> Float64[np.ndarray, " n"]:
    """Signed offsets of the points where the contour of half coverage crosses the lines of a grid ``finer`` than the
    image. Holes in the coverage have a contour too. Mesh, Gaussians and camera in one frame."""
    alpha = fine_alpha(gaussians, camera, rasterizer, low_pass_px2=low_pass_px2, finer=finer)
    return signed_offsets(contour_points(alpha) / finer, silhouette(mesh, camera))


def fine_alpha(
    gaussians: Gaussians, camera: Camera, rasterizer: Rasterizer, *, low_pass_px2: float, finer: int
) -> Float64[np.ndarray, "h w"]:
    """Alpha sampled ``finer`` times as densely along each axis, as the function that the camera samples once per pixel:
    the screen's filter keeps its width in pixels of the camera."""
    dense = camera.resized(camera.width * finer, camera.height * finer)
    background = torch.zeros(3).to(gaussians.means)
    with torch.no_grad():
        rendering = rasterizer.render(gaussians, dense, background, low_pass_px2=low_pass_px2 * finer * finer)
    return rendering.alpha.double().cpu().numpy()


def contour_points(alpha: Float64[np.ndarray, "h w"]) -> Float64[np.ndarray, "n 2"]:
    """Points (column, row) where alpha crosses ``LEVEL`` along rows and columns, linear between pixel centres."""
    points = []
    for axis in (1, 0):
        before = alpha[:, :-1] if axis == 1 else alpha[:-1]
        after = alpha[:, 1:] if axis == 1 else alpha[1:]
        rows, columns = np.nonzero((before < LEVEL) != (after < LEVEL))
        low, high = before[rows, columns], after[rows, columns]
        place = np.stack([columns, rows], axis=1) + 0.5
        place[:, 1 - axis] += (LEVEL - low) / (high - low)
        points.append(place)
    return np.concatenate(points)


def silhouette(mesh: Mesh, camera: Camera) -> Silhouette:
    """The outline of a closed, consistently oriented mesh that lies in front of the camera.

    Raises ValueError where a vertex does not, or where an edge does not have two faces.
    """
    places = _on_screen(mesh.vertices, camera)
    corners = places[mesh.faces]
    # Rows grow downwards, so a face that turns counter-clockwise as seen has a negative area.
    towards = _doubled_areas(corners) < 0.0
    triangles = corners[towards]
    edges, inner = _folds(mesh.faces, towards)
    if len(edges) == 0:
        return Silhouette(triangles=triangles, pieces=np.zeros((0, 2, 2)))
    ends = places[edges]
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(length, 1e-300)[:, None]
    # The third corner of the face towards the camera is on the inner side.
    flip = np.sum(outwards * (places[inner] - ends[:, 0]), axis=1) > 0.0
    outwards[flip] *= -1.0
    count = np.maximum(1, np.ceil(length / _PIECE)).astype(np.int64)
    edge = np.repeat(np.arange(len(edges)), count)
    index = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    shares = np.stack([index, index + 1], axis=1) / count[edge][:, None]
    pieces = ends[edge][:, :1] + shares[:, :, None] * along[edge][:, None]
    visible = ~is_covered(pieces.mean(axis=1) + _ASIDE * outwards[edge], triangles)
    return Silhouette(triangles=triangles, pieces=pieces[visible])


def signed_offsets(points: Float64[np.ndarray, "n 2"], outline: Silhouette) -> Float64[np.ndarray, " n"]:
    """Distance of each point to the outline, negative where the mesh covers it. Raises ValueError if there is none."""
    if len(outline.pieces) == 0:
        raise ValueError("the mesh has no outline in this view")
    if len(points) == 0:
        return np.zeros(0)
    count = min(_NEIGHBOURS, len(outline.pieces))
    _, nearest = KDTree(outline.pieces.mean(axis=1)).query(points, k=count)
    start, end = np.moveaxis(outline.pieces[nearest.reshape(len(points), count)], 2, 0)
    along = end - start
    share = np.sum((points[:, None] - start) * along, axis=2) / np.maximum(np.sum(along * along, axis=2), 1e-300)
    foot = start + np.clip(share, 0.0, 1.0)[:, :, None] * along
    distance = np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)
    return np.where(is_covered(points, outline.triangles), -distance, distance)


def is_covered(points: Float64[np.ndarray, "n 2"], triangles: Float64[np.ndarray, "t 3 2"]) -> Bool[np.ndarray, " n"]:
    """Whether each point lies in at least one triangle, all of which have a negative area."""
    covered = np.zeros(len(points), dtype=bool)
    if len(triangles) == 0 or len(points) == 0:
        return covered
    for point, triangle in _candidates(points, triangles):
        corners, place = triangles[triangle], points[point]
        inside = np.ones(len(point), dtype=bool)
        for corner in range(3):
            start, end = corners[:, corner], corners[:, (corner + 1) % 3]
            along, across = end - start, place - start
            inside &= along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0] <= 0.0
        covered[point[inside]] = True
    return covered


def _candidates(
    points: Float64[np.ndarray, "n 2"], triangles: Float64[np.ndarray, "t 3 2"]
) -> Iterator[tuple[Int64[np.ndarray, " c"], Int64[np.ndarray, " c"]]]:
    """Pairs of a point and a triangle whose bounding boxes share a square tile of the screen."""
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    tile = max(1e-9, float(np.sqrt(np.prod(high - low, axis=1).mean())))
    origin = low.min(axis=0)
    first, last = (np.floor((bound - origin) / tile).astype(np.int64) for bound in (low, high))
    span = last - first + 1
    columns = int(last[:, 0].max()) + 1
    count = span.prod(axis=1)
    triangle = np.repeat(np.arange(len(triangles)), count)
    index = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    place = first[triangle] + np.stack([index % span[triangle, 0], index // span[triangle, 0]], axis=1)
    in_tile = place[:, 1] * columns + place[:, 0]
    order = np.argsort(in_tile, kind="stable")
    in_tile, triangle = in_tile[order], triangle[order]

    at = np.floor((points - origin) / tile).astype(np.int64)
    # Left and right of all tiles there is nothing; the number of such a place would be that of another row's tile.
    known = (at[:, 0] >= 0) & (at[:, 0] < columns)
    wanted = np.where(known, at[:, 1] * columns + at[:, 0], -1)
    start, stop = np.searchsorted(in_tile, wanted, "left"), np.searchsorted(in_tile, wanted, "right")
    ends = np.cumsum(stop - start)
    begin = 0
    while begin < len(points):
        done = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, done + _PAIRS_AT_ONCE)))
        width = (stop - start)[begin:end]
        point = np.repeat(np.arange(begin, min(end, len(points))), width)
        index = np.arange(len(point)) - np.repeat(np.cumsum(width) - width, width)
        yield point, triangle[start[point] + index]
        begin = end


def _folds(
    faces: Int64[np.ndarray, "f 3"], towards: Bool[np.ndarray, " f"]
) -> tuple[Int64[np.ndarray, "e 2"], Int64[np.ndarray, " e"]]:
    """Edges between a face towards the camera and one away from it, and the third vertex of the first."""
    start, end, third = (
        faces.reshape(-1),
        np.roll(faces, -1, axis=1).reshape(-1),
        np.roll(faces, -2, axis=1).reshape(-1),
    )
    size = int(faces.max()) + 1
    name = np.minimum(start, end) * size + np.maximum(start, end)
    order = np.argsort(name, kind="stable")
    name = name[order]
    if len(name) % 2 or (name[::2] != name[1::2]).any() or (name[1:-1:2] == name[2::2]).any():
        raise ValueError("the mesh is not closed: an edge does not have two faces")
    facing = towards[order // 3].reshape(-1, 2)
    fold = facing[:, 0] != facing[:, 1]
    chosen = order.reshape(-1, 2)[fold, np.where(facing[fold, 0], 0, 1)]
    return np.stack([start[chosen], end[chosen]], axis=1), third[chosen]


def _on_screen(vertices: Float64[np.ndarray, "v 3"], camera: Camera) -> Float64[np.ndarray, "v 2"]:
    places = camera.project(vertices)
    if np.isnan(places).any():
        raise ValueError("a vertex of the mesh is not in front of the camera")
    return places


def _doubled_areas(corners: Float64[np.ndarray, "t 3 2"]) -> Float64[np.ndarray, " t"]:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
