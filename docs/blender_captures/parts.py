"""Closed surfaces of which objects are put together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float64
from numpy.typing import ArrayLike
from trimesh.creation import box, cylinder

CRUMB = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """A closed surface and what it looks like."""

    mesh: trimesh.Trimesh
    """With texture coordinates and an image, these are its colour."""
    paint: str
    """A name of ``paints.PAINTS``."""
    tint: Float64[np.ndarray, "v 3"] | None = None
    """Linear colour per vertex; the paint's is multiplied by it."""


def at(mesh: trimesh.Trimesh, place: Sequence[float], turn: Sequence[float] = (0, 0, 0)) -> trimesh.Trimesh:
    """A copy, turned (degrees about x, y, z) and moved."""
    mesh = mesh.copy()
    mesh.apply_transform(trimesh.transformations.euler_matrix(*np.radians(turn)))
    mesh.apply_translation(place)
    return mesh


def rod(start: ArrayLike, end: ArrayLike, radius: float, sections: int = 10) -> trimesh.Trimesh:
    return cylinder(radius=radius, segment=np.stack([np.asarray(start), np.asarray(end)]), sections=sections)


def block(size: Sequence[float], place: Sequence[float], turn: Sequence[float] = (0, 0, 0)) -> trimesh.Trimesh:
    return at(box(size), place, turn)


def disc(
    radius: float, height: float, place: Sequence[float], turn: Sequence[float] = (0, 0, 0), sections: int = 32
) -> trimesh.Trimesh:
    return at(cylinder(radius=radius, height=height, sections=sections), place, turn)


def united(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """The union of closed surfaces; faces of theirs that point inward are turned round in place."""
    for mesh in meshes:
        mesh.merge_vertices()
        mesh.update_faces(mesh.nondegenerate_faces())
        mesh.fix_normals()
        if mesh.volume < 0:
            mesh.invert()
    return trimesh.boolean.union(list(meshes), engine="manifold")


def without_crumbs(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Without bodies and hollows of less than ``CRUMB`` of its volume, which no photograph shows."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    corners = mesh.vertices[mesh.faces]
    shares = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volumes = np.bincount(labels, shares)
    kept = trimesh.Trimesh(mesh.vertices, mesh.faces[np.abs(volumes[labels]) >= CRUMB * mesh.volume], process=False)
    kept.remove_unreferenced_vertices()
    return kept


def bare(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Its shape alone: vertices that only texture coordinates keep apart are one."""
    shape = trimesh.Trimesh(mesh.vertices.copy(), mesh.faces.copy(), process=False)
    shape.merge_vertices()
    return shape


def standing(pieces: Sequence[Piece]) -> tuple[list[Piece], trimesh.Trimesh]:
    """Moved and scaled into the unit ball around the origin, and the surface of all of them: the truth."""
    shapes = [bare(piece.mesh) for piece in pieces]
    whole = without_crumbs(united(shapes) if len(shapes) > 1 else shapes[0])
    middle = whole.bounds.mean(axis=0)
    scale = 1 / np.linalg.norm(whole.vertices - middle, axis=1).max()
    for mesh in (whole, *(piece.mesh for piece in pieces)):
        mesh.apply_translation(-middle)
        mesh.apply_scale(scale)
    return list(pieces), whole
