"""Vertices at the same place, which other programs merge on reading: what was closed by its indices is open then."""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from sculpt_framework.geometry.topology import directed_edges

_RESOLUTION = 2.0**-20
"""Least distance between two vertices, as a share of the largest coordinate: eight steps of a 32-bit float there, so
that vertices stay distinct in files, also where a few sums rounded them."""
_LARGEST = 1e-4
"""The same as a share of the mesh's diagonal, above which 32-bit floats are too coarse for the mesh and nothing is
moved."""
_STEP = 1e-3
"""First step, as a share of the way to the mean of a vertex's neighbours."""
_ATTEMPTS = 12
"""Each with steps twice as long as the one before."""


def separate(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]) -> Float64[np.ndarray, "v 3"]:
    """The vertices, those at the same place moved apart; faces stay what they are, and so does the topology.

    A vertex counts as at the place of another within about 1e-6 of the largest coordinate. It moves towards the mean of
    its neighbours, by a thousandth of the way, where that is enough: ends of a short edge draw apart, sheets that touch
    part. Comes back as given where no two vertices coincide, and where the mesh is so far from the origin that 32-bit
    floats cannot hold it. Vertices that no face uses are not looked at.
    """
    used = np.unique(faces)
    if len(used) < 2:
        return vertices
    points = vertices[used]
    least = _RESOLUTION * float(np.abs(points).max())
    if not 0 < least < _LARGEST * float(np.linalg.norm(np.ptp(points, axis=0))):
        return vertices
    edges = np.searchsorted(used, directed_edges(faces))
    random = np.random.default_rng(0)
    moved = points.copy()
    for attempt in range(_ATTEMPTS):
        near, _ = KDTree(moved).query(moved, k=2, distance_upper_bound=least)
        close = np.flatnonzero(np.isfinite(near[:, 1]))
        if len(close) == 0:
            break
        way = _ring_means(moved, edges)[close] - moved[close]
        share = np.maximum(_STEP, least / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), least))
        # Where the means coincide as well, chance parts what they do not.
        chance = random.standard_normal(way.shape)
        moved[close] += np.minimum(share * 2**attempt, 0.5) * way + 0.5 * least * 2**attempt * chance
    if np.array_equal(moved, points):
        return vertices
    out = vertices.copy()
    out[used] = moved
    return out


def merged(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]) -> Int64[np.ndarray, "f 3"]:
    """The faces with one name for all vertices at the same place, in 32-bit floats; all faces are kept."""
    # Adding 0 makes -0 the 0 that it equals.
    rows = np.ascontiguousarray(vertices.astype(np.float32) + np.float32(0))
    order = np.lexsort(rows.T)
    first = np.ones(len(rows), bool)
    first[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    name = np.zeros(len(rows), np.int64)
    name[order] = np.cumsum(first) - 1
    return name[faces]


def _ring_means(points: Float64[np.ndarray, "v 3"], edges: Int64[np.ndarray, "e 2"]) -> Float64[np.ndarray, "v 3"]:
    """Mean of the ends of the edges that leave each vertex."""
    start, end = edges.T
    count = np.bincount(start, minlength=len(points))
    sums = np.stack([np.bincount(start, points[end, axis], minlength=len(points)) for axis in range(3)], axis=1)
    return sums / np.maximum(count, 1)[:, None]
