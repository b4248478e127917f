"""Where a surface passes through itself."""

import igl
import numpy as np

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.geometry.topology import directed_edges, edge_ends, edge_names

_FROM_END = 1e-6
"""Share of an edge's length, at either end, that is taken for touching."""


def count_self_intersections(mesh: Mesh) -> int:
    """Pairs of faces that cross: an edge of one passes through the inside of the other, away from its vertices.

    Exact for faces in general position, up to rounding and to a millionth of an edge at its ends. Not counted: faces
    that only touch, and faces that overlap in one plane.
    """
    if len(mesh.faces) == 0:
        return 0
    names = edge_names(directed_edges(mesh.faces))
    ordered = np.sort(names)
    edges = ordered[np.flatnonzero(np.diff(ordered, prepend=-1))]
    ends = edge_ends(edges)
    tree = igl.AABB()
    tree.init(mesh.vertices, mesh.faces)
    start, way = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]]
    # Nearly all edges meet nothing between their ends, which one quick look at each tells.
    within = start + _FROM_END * way
    met, _, _ = tree.intersect_ray_first(mesh.vertices, mesh.faces, within, way, 1 - 2 * _FROM_END)
    suspects = np.flatnonzero(np.asarray(met) >= 0)
    if len(suspects) == 0:
        return 0
    # One list per edge of (face, place along the edge, u, v), for the whole ray: before and behind the edge too.
    hits = tree.intersect_ray(mesh.vertices, mesh.faces, start[suspects], way[suspects])
    edge = np.repeat(suspects, [len(found) for found in hits])
    face = np.array([hit[0] for found in hits for hit in found], dtype=np.int64)
    place = np.array([hit[1] for found in hits for hit in found], dtype=np.float64)
    crosses = (place > 0) & (place < 1)
    crosses &= ~(mesh.faces[face][:, :, None] == ends[edge][:, None, :]).any((1, 2))
    edge, face = edge[crosses], face[crosses]
    # Every face along a crossing edge crosses what the edge crosses.
    edge_of_half_edge = np.searchsorted(edges, names)
    order = np.argsort(edge_of_half_edge, kind="stable")
    first = np.searchsorted(edge_of_half_edge[order], np.arange(len(ends) + 1))
    pairs = {
        (min(owner, crossed), max(owner, crossed))
        for one, crossed in zip(edge.tolist(), face.tolist(), strict=True)
        for owner in (order[first[one] : first[one + 1]] // 3).tolist()
    }
    return len(pairs)
