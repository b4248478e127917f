"""What can be proved of a mesh by counting: closed, manifold, oriented, of how many pieces and holes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.self_intersections import count_self_intersections
from sculpt_framework.geometry import coincident, topology


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Facts about a triangle mesh as it is: only for ``watertight_merged`` vertices at the same place are merged."""

    vertices: int
    """Vertices that faces use."""
    faces: int
    unused_vertices: int
    """Vertices that no face uses."""
    degenerate_faces: int
    """Faces that name a vertex twice or have area 0."""
    coincident_vertices: int
    """Vertices fewer, of those that faces use, once those at the same place are merged, in 32-bit floats."""
    boundary_edges: int
    """Edges with one face."""
    edge_manifold: bool
    """No edge has more than two faces."""
    vertex_manifold: bool
    """The faces round every vertex form one fan."""
    watertight: bool
    """There are faces, and every edge has exactly two."""
    watertight_merged: bool
    """Watertight also once vertices at the same place are merged, which other programs do on reading."""
    consistently_oriented: bool
    """No two faces run along an edge in the same direction."""
    outward: bool
    """Watertight, consistently oriented, and positive volume enclosed."""
    components: int
    """Pieces that hang together by shared vertices."""
    euler_characteristic: int
    """Vertices - edges + faces."""
    genus: int | None
    """Handles, summed over the components; None unless the mesh is a closed, oriented manifold."""
    area: float
    """Surface area, scene units squared."""
    signed_volume: float
    """Volume enclosed by faces that turn counter-clockwise seen from outside, scene units cubed; negative for a mesh
    turned inside out, without meaning for one that is not watertight."""
    self_intersections: int | None
    """Pairs of faces that cross each other; None where it was not counted."""


def certify(
    vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"], *, self_intersections: bool = False
) -> Certificate:
    """Certify a mesh. Self-intersections are counted when asked for: half a second per 100 000 faces.

    A mesh without faces gets a certificate too: not watertight, no components. Raises ValueError where a vertex is not
    finite or a face names one that is not there.
    """
    mesh = Mesh(vertices=vertices, faces=faces)
    empty = len(faces) == 0
    areas = mesh.areas
    named = np.zeros(len(vertices), bool)
    named[faces] = True
    used = int(named.sum())
    boundary = len(topology.boundary_edges(faces))
    edge_manifold = topology.is_edge_manifold(faces)
    vertex_manifold = topology.is_vertex_manifold(faces)
    watertight = not empty and boundary == 0 and edge_manifold
    merged = coincident.merged(vertices, faces)
    coinciding = used - len(np.unique(merged))
    oriented = topology.is_consistently_oriented(faces)
    components = 0 if empty else topology.components(faces)[0]
    euler = topology.euler_characteristic(faces)
    volume = 0.0 if empty else topology.signed_volume(vertices, faces)
    return Certificate(
        vertices=used,
        faces=len(faces),
        unused_vertices=len(vertices) - used,
        degenerate_faces=int((areas == 0).sum()),
        coincident_vertices=coinciding,
        boundary_edges=boundary,
        edge_manifold=edge_manifold,
        vertex_manifold=vertex_manifold,
        watertight=watertight,
        watertight_merged=watertight and (coinciding == 0 or _is_closed(merged)),
        consistently_oriented=oriented,
        outward=watertight and oriented and volume > 0,
        components=components,
        euler_characteristic=euler,
        genus=components - euler // 2 if watertight and oriented and vertex_manifold else None,
        area=float(areas.sum()),
        signed_volume=volume,
        self_intersections=count_self_intersections(mesh) if self_intersections else None,
    )


def _is_closed(faces: Int64[np.ndarray, "f 3"]) -> bool:
    return len(topology.boundary_edges(faces)) == 0 and topology.is_edge_manifold(faces)
