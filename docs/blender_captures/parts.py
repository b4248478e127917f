"""Closed surfaces of which objects are put together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float64
from numpy.typing import ArrayLike
from trimesh.creation import box, cylinder
from trimesh.visual import TextureVisuals

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


def revolved(profile: Float64[np.ndarray, "n 2"], sections: int) -> trimesh.Trimesh:
    """A profile of radii and heights turned about z; from the middle below, up outside, and down inside, it is closed.

    Texture coordinates: the share of the turn, and the height for the outside only.
    """
    rows = len(profile)
    turn = np.linspace(0, 2 * np.pi, sections + 1)
    x, y = profile[:, 0, None] * np.cos(turn), profile[:, 0, None] * np.sin(turn)
    # The last column lies on the first to the bit.
    x[:, -1], y[:, -1] = x[:, 0], y[:, 0]
    vertices = np.stack([x, y, np.broadcast_to(profile[:, 1, None], x.shape)], axis=2).reshape(-1, 3)
    top = int(profile[:, 1].argmax())
    height = np.where(np.arange(rows) <= top, profile[:, 1] / profile[:, 1].max(), 0.999)
    uv = np.stack(np.broadcast_arrays(turn / (2 * np.pi), height[:, None]), axis=2).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(sections), indexing="ij")
    a = (i * (sections + 1) + j).ravel()
    b, c, d = a + 1, a + sections + 2, a + sections + 1
    mesh = trimesh.Trimesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), process=False)
    mesh.visual = TextureVisuals(uv=uv)
    return mesh


def bow(radii: Sequence[float], thickness: Sequence[float], reach: float) -> trimesh.Trimesh:
    """Two thirds of a ring in the plane of x and z around (``reach``, 0, 0), open toward the z axis: a handle.

    ``radii`` along x and z; ``thickness``: half of it, away from the middle and along y.
    """
    turn = np.linspace(-2.0, 2.0, 60)
    middle = np.stack([reach + radii[0] * np.cos(turn), np.zeros(60), radii[1] * np.sin(turn)], axis=1)
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    away = np.stack([np.cos(turn), np.zeros(60), np.sin(turn)], axis=1)
    sideways = np.array([0, 1, 0])
    ring = thickness[0] * np.cos(around)[:, None] * away[:, None] + thickness[1] * np.sin(around)[:, None] * sideways
    vertices = (middle[:, None] + ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(59), np.arange(24), indexing="ij")
    a, b = (i * 24 + j).ravel(), (i * 24 + (j + 1) % 24).ravel()
    faces = [np.stack([a, b, b + 24], 1), np.stack([a, b + 24, a + 24], 1)]
    for start in (0, 59 * 24):
        fan = np.stack([np.full(22, start), start + np.arange(1, 23), start + np.arange(2, 24)], 1)
        faces.append(fan[:, ::-1] if start == 0 else fan)
    mesh = trimesh.Trimesh(vertices, np.concatenate(faces), process=False)
    mesh.fix_normals()
    return mesh


def united(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """The union of closed surfaces, which are ``turned_outward`` in place."""
    return trimesh.boolean.union([turned_outward(mesh) for mesh in meshes], engine="manifold")


def turned_outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A closed surface in place, without what keeps it from being one: doubled vertices, faces that point inward."""
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.fix_normals()
    if mesh.volume < 0:
        mesh.invert()
    return mesh


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
