"""What a triangle mesh is made of, as integers: closedness, manifoldness, orientation, genus, components.

Faces are integer rows "f 3" of numpy or torch (any device); answers are plain Python values or numpy arrays. Vertices
that no face uses are ignored.
"""

import numpy as np
import torch
from jaxtyping import Float, Int, Int64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

Faces = Int[np.ndarray, "f 3"] | Int[Tensor, "f 3"]
Vertices = Float[np.ndarray, "v 3"] | Float[Tensor, "v 3"]


def _array(values: np.ndarray | Tensor) -> np.ndarray:
    return values.detach().cpu().numpy() if isinstance(values, torch.Tensor) else values


def directed_edges(faces: Faces) -> Int64[np.ndarray, "e 2"]:
    """The three edges of face 0, then those of face 1, ...: edge n goes from corner n of its face to the next."""
    array = _array(faces).astype(np.int64)
    return np.stack([array, np.roll(array, -1, axis=1)], axis=2).reshape(-1, 2)


def edge_names(edges: Int64[np.ndarray, "e 2"]) -> Int64[np.ndarray, " e"]:
    """One integer per edge, whatever its direction."""
    start, end = edges.T  # Many times as fast as reductions along so short an axis.
    return (np.minimum(start, end) << 32) | np.maximum(start, end)


def edge_ends(names: Int64[np.ndarray, " e"]) -> Int64[np.ndarray, "e 2"]:
    """The two vertices of the edges of these names, the smaller first."""
    return np.stack([names >> 32, names & 0xFFFFFFFF], axis=1)


def boundary_edges(faces: Faces) -> Int64[np.ndarray, "b 2"]:
    """Edges with one face, directed as in that face. A mesh without any is closed."""
    edges = directed_edges(faces)
    names = edge_names(edges)
    ordered = np.sort(names)
    alone = np.ones(len(ordered), bool)
    alone[1:] &= ordered[1:] != ordered[:-1]
    alone[:-1] &= ordered[:-1] != ordered[1:]
    return edges[np.isin(names, ordered[alone])]


def is_edge_manifold(faces: Faces) -> bool:
    """Whether no edge has more than two faces."""
    ordered = np.sort(edge_names(directed_edges(faces)))
    return not bool((ordered[2:] == ordered[:-2]).any())


def is_vertex_manifold(faces: Faces) -> bool:
    """Whether the mesh is edge-manifold and the faces at each vertex form one fan, open or closed."""
    edges = directed_edges(faces)
    if not is_edge_manifold(faces):
        return False
    # Corners of faces are nodes; an edge shared by two faces links the two corners at each of its ends.
    first, second = _paired_sides(edges)
    following = np.arange(len(edges)) - np.arange(len(edges)) % 3 + (np.arange(len(edges)) + 1) % 3
    corner_a = np.concatenate([first, following[first]])
    same_direction = edges[first, 0] == edges[second, 0]
    corner_b = np.concatenate(
        [np.where(same_direction, second, following[second]), np.where(same_direction, following[second], second)]
    )
    fans, _ = _connected(corner_a, corner_b, len(edges))
    return fans == _distinct(edges[:, 0])


def is_consistently_oriented(faces: Faces) -> bool:
    """Whether no two faces pass an edge in the same direction."""
    edges = directed_edges(faces)
    return _distinct((edges[:, 0] << 32) | edges[:, 1]) == len(edges)


def euler_characteristic(faces: Faces) -> int:
    """Vertices in use - edges + faces; for a closed oriented mesh the sum of 2 - 2 genus over its components."""
    edges = directed_edges(faces)
    return _distinct(edges.reshape(-1)) - _distinct(edge_names(edges)) + len(faces)


def signed_volume(vertices: Vertices, faces: Faces) -> float:
    """Enclosed volume of a closed mesh, positive where its faces turn outward. Computed in float64."""
    points = _array(vertices).astype(np.float64)
    used = points[_array(faces)]
    # Taking a point of the mesh as origin keeps small meshes far from the origin accurate.
    a, b, c = np.moveaxis(used - used.reshape(-1, 3).mean(axis=0), 1, 0)
    return float((np.cross(a, b) * c).sum() / 6)


def components(faces: Faces) -> tuple[int, Int64[np.ndarray, " f"]]:
    """Number of pieces that hang together by shared vertices, and the piece of each face."""
    edges = directed_edges(faces)
    count, label = _connected(edges[:, 0], edges[:, 1], int(edges.max(initial=-1)) + 1)
    piece = label[edges[::3, 0]]
    # A vertex that no face uses is a piece of the graph, not of the mesh.
    used = np.zeros(count, bool)
    used[piece] = True
    return int(used.sum()), (np.cumsum(used) - 1)[piece]


def _distinct(values: Int64[np.ndarray, " n"]) -> int:
    """How many different values there are; a plain sort is many times as fast as looking them up."""
    ordered = np.sort(values)
    return int((ordered[1:] != ordered[:-1]).sum()) + min(1, len(ordered))


def _paired_sides(edges: Int64[np.ndarray, "e 2"]) -> tuple[Int64[np.ndarray, " p"], Int64[np.ndarray, " p"]]:
    """Rows of the two directed edges of each edge that has two faces."""
    names = edge_names(edges)
    order = np.argsort(names, kind="stable")
    twin = np.flatnonzero(names[order[1:]] == names[order[:-1]])
    return order[twin], order[twin + 1]


def _connected(
    a: Int64[np.ndarray, " p"], b: Int64[np.ndarray, " p"], nodes: int
) -> tuple[int, Int64[np.ndarray, " n"]]:
    """Connected components of the graph with links a[n] - b[n]."""
    graph = coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(nodes, nodes))
    count, label = connected_components(graph, directed=False)
    return int(count), label.astype(np.int64)
