"""What the mesh can be coloured by."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.triangle_quality import triangle_shapes
from sculpt_framework.evaluation.visibility import points_seen
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.types import Camera
from sculpt_framework.viewing.frames import Frame

COLORS, NORMALS, ERROR, SEEN, QUALITY, KEYS = "colours", "normals", "error", "seen", "triangles", "face keys"
MODES = (COLORS, NORMALS, ERROR, SEEN, QUALITY, KEYS)
_RAMP = np.array([[0.16, 0.18, 0.45], [0.13, 0.53, 0.58], [0.55, 0.78, 0.35], [0.99, 0.83, 0.2], [0.83, 0.16, 0.1]])
"""From low to high."""
_LARGE_ERROR_SHARE = 0.01
"""Of the reference's diagonal: the top of the ramp."""
_BEST_ANGLE = 60.0
_CAMERAS_AT_MOST = 40
_GREY = 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class Painted:
    """A mesh with colours at its vertices, sRGB in [0, 1], and what they mean."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    colors: Float[np.ndarray, "v 3"]
    legend: str


def paint(frame: Frame, mode: str, reference: MeasuredMesh | None, cameras: Sequence[Camera]) -> Painted:
    """Colour the frame's mesh. Where what a mode needs is not known it is grey, and the legend says so."""
    mesh = Mesh(vertices=frame.vertices.astype(np.float64), faces=frame.faces)
    colors, legend = np.full(frame.vertices.shape, _GREY), ""
    match mode:
        case "normals":
            colors = 0.5 + 0.5 * vertex_normals(mesh.vertices, mesh.faces)
            legend = "red, green, blue: the normal along x, y, z"
        case "error":
            legend = "no reference mesh is known"
            if reference is not None:
                top = _LARGE_ERROR_SHARE * reference.mesh.diagonal
                distance = np.sqrt(reference.squared_distances(mesh.vertices)[0])
                colors = ramp(distance / top)
                legend = f"blue 0 to red {top:.3g}, 1 % of the reference's diagonal; mean {distance.mean():.3g}"
        case "seen":
            legend = "no cameras are known"
            if cameras and len(mesh.faces):
                some = cameras[:: -(-len(cameras) // _CAMERAS_AT_MOST)]
                seen = points_seen(MeasuredMesh(mesh, samples=1), mesh.vertices, some)
                colors = np.where(seen[:, None], [0.25, 0.6, 0.35], [0.8, 0.25, 0.2])
                legend = f"green: seen by one of {len(some)} cameras; red: by none ({100 * (1 - seen.mean()):.0f} %)"
        case "triangles":
            angle = triangle_shapes(mesh).minimum_angle
            legend = f"smallest angle: red 0 to blue 60 degrees; {100 * (angle < 10).mean():.1f} % below 10"
            return _by_face(frame, ramp(1 - angle / _BEST_ANGLE), legend)
        case "face keys":
            if frame.face_keys is not None:
                return _by_face(frame, key_colors(frame.face_keys), "a face that lives on keeps its colour")
            legend = "the keys of these faces are not known"
        case _:
            colors = frame.colors
    return Painted(vertices=frame.vertices, faces=frame.faces, colors=colors.astype(np.float32), legend=legend)


def ramp(share: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """0 dark blue to 1 red; beyond, the ends."""
    place = np.clip(share, 0, 1) * (len(_RAMP) - 1)
    stops = np.arange(len(_RAMP))
    return np.stack([np.interp(place, stops, _RAMP[:, channel]) for channel in range(3)], axis=1)


def key_colors(keys: Int64[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """A colour for every key, the same whenever the key is met."""
    mixed = keys.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    channels = [(mixed >> np.uint64(shift) & np.uint64(255)).astype(np.float64) / 255 for shift in (56, 48, 40)]
    return 0.25 + 0.7 * np.stack(channels, axis=1)


def _by_face(frame: Frame, colors: Float[np.ndarray, "f 3"], legend: str) -> Painted:
    """Faces share no vertices, so that each has one colour."""
    return Painted(
        vertices=frame.vertices[frame.faces].reshape(-1, 3),
        faces=np.arange(3 * len(frame.faces)).reshape(-1, 3),
        colors=np.repeat(colors, 3, axis=0).astype(np.float32),
        legend=legend,
    )
