"""A triangle mesh as a camera sees it: which face at which pixel, how deep, in what colour."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64, Int32, Int64

from sculpt_framework.cpu_kernels import kernel_cache
from sculpt_framework.types import Camera

with kernel_cache("export", Path(__file__).with_name("mesh_pixel_kernels.py")):
    from sculpt_framework.export import mesh_pixel_kernels as kernels

Vertices = Float64[np.ndarray, "v 3"]
Faces = Int64[np.ndarray, "f 3"]
_SLACK = 2e-3
"""Share of the mesh's diagonal by which a point may lie behind what a pixel shows and still be seen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshPixels:
    """What is nearest at each pixel's centre."""

    face: Int32[np.ndarray, "h w"]
    """-1 where there is no surface."""
    weights: Float32[np.ndarray, "h w 3"]
    """Of the face's vertices, on the surface; they add up to 1."""
    depth: Float32[np.ndarray, "h w"]
    """Camera z; infinite where there is no surface."""

    def interpolate(self, faces: Faces, values: Float[np.ndarray, "v c"]) -> Float[np.ndarray, "h w c"]:
        """Values of vertices at the pixels; 0 where there is no surface."""
        seen = self.face >= 0
        out = np.zeros((*self.face.shape, values.shape[1]), values.dtype)
        out[seen] = np.einsum("nk,nkc->nc", self.weights[seen], values[faces[self.face[seen]]])
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Visibility:
    """How cameras see points of a mesh, one array entry a point."""

    times_seen: Int32[np.ndarray, " n"]
    """Number of cameras that see it."""
    best_cosine: Float32[np.ndarray, " n"]
    """Of the angle between the normal and the most frontal of those cameras; 0 where none sees it."""


def lens_values(camera: Camera) -> Float64[np.ndarray, " 4"]:
    """fx, fy, cx, cy."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def from_camera_to_camera(
    first: Camera, second: Camera
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]]:
    """Rotation and shift that lead from the first camera's frame into the second's."""
    pose, target = (camera.world_to_camera.double().numpy() for camera in (first, second))
    between = target @ np.linalg.inv(pose)
    return np.ascontiguousarray(between[:3, :3]), np.ascontiguousarray(between[:3, 3])


def draw_mesh(vertices: Vertices, faces: Faces, camera: Camera, *, closed: bool = False) -> MeshPixels:
    """Mesh and camera in the same frame. Faces that reach behind the camera are left out.

    A surface known to be ``closed``, seen from outside, is drawn in less time.
    """
    local = camera.local(vertices)
    before, places = local[:, 2] > 0, camera.pixels(local)
    inverse = 1 / np.where(before, local[:, 2], np.inf)
    places[~before] = 0
    return draw_triangles(places, inverse, faces, camera.width, camera.height, closed=closed)


def draw_triangles(
    places: Float64[np.ndarray, "v 2"],
    inverse_depth: Float64[np.ndarray, " v"],
    faces: Faces,
    width: int,
    height: int,
    *,
    closed: bool = False,
) -> MeshPixels:
    """Triangles of corners given by columns and rows, and 1/z; ``closed`` as in ``draw_mesh``."""
    face = np.full((height, width), -1, np.int32)
    weights, nearest = np.zeros((height, width, 3), np.float32), np.zeros((height, width))
    kernels.draw(places, inverse_depth, np.ascontiguousarray(faces), closed, face, weights, nearest)
    depth = np.where(face >= 0, 1 / np.where(face >= 0, nearest, 1), np.inf).astype(np.float32)
    return MeshPixels(face=face, weights=weights, depth=depth)


def farthest_around(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Largest depth in the 3 x 3 pixels around each, beyond all things beside pixels without surface.

    At a steep place a pixel's centre is nearer than its border: the depths around it say how much.
    """
    return np.asarray(cv2.dilate(np.where(np.isfinite(depth), depth, np.float32(3e38)), np.ones((3, 3), np.uint8)))


def cosines(
    points: Vertices, normals: Vertices, camera: Camera, depth: Float32[np.ndarray, "h w"], slack: float
) -> Float32[np.ndarray, " n"]:
    """How frontally a camera sees points with normals: a cosine, 0 where something hides them or they look away.

    ``depth`` is the surface's as ``draw_mesh`` has it.
    """
    farthest = farthest_around(depth)
    out = np.zeros(len(points), np.float32)
    pose, center = camera.world_to_camera.double().numpy(), camera.position.double().numpy()
    kernels.see(points, normals, pose, lens_values(camera), center, farthest, slack, out)
    return out


def visibility_slack(vertices: Vertices) -> float:
    """What counts as the same depth on a mesh of this size."""
    return _SLACK * float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))


def visibility(
    vertices: Vertices, faces: Faces, normals: Vertices, cameras: Sequence[Camera], least: float = 0.1
) -> Visibility:
    """How the cameras see the vertices of a mesh. A view at less than ``least`` of the cosine shows nothing."""
    seen, best = np.zeros(len(vertices), np.int32), np.zeros(len(vertices), np.float32)
    slack = visibility_slack(vertices)
    for camera in cameras:
        now = cosines(vertices, normals, camera, draw_mesh(vertices, faces, camera).depth, slack)
        seen += now >= least
        best = np.maximum(best, np.where(now >= least, now, 0))
    return Visibility(times_seen=seen, best_cosine=best)
