"""How well two photographs agree on a surface: one laid into the other through it, compared by normalised correlation.

Correlation of small windows knows nothing of brightness and contrast, so that light which differs between photographs
does not count; and a window is warped pixel by pixel, so that it may lie across anything the mesh can show. The
derivative by the corners of the mesh is exact but for which pixels can be compared (Pons, Keriven and Faugeras 2007;
Vu, Labatut, Pons and Keriven 2012).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from sculpt_framework.cpu_kernels import kernel_cache
from sculpt_framework.export.mesh_pixels import (
    Faces,
    MeshPixels,
    Vertices,
    draw_mesh,
    farthest_around,
    from_camera_to_camera,
    lens_values,
)
from sculpt_framework.types import Camera

with kernel_cache("stereo", Path(__file__).with_name("agreement_kernels.py")):
    from sculpt_framework.multi_view_stereo import agreement_kernels as kernels

_LEAST_COSINE = 0.25
"""Places that a camera sees at a flatter angle are not compared."""
_FILLED = 0.6
"""Share of a window that both cameras must see."""
_WORST = 0.7
"""1 - correlation from which on a window says only that something else is seen: a highlight, a shadow."""
_NOISE = 1.5 / 255
"""Contrast that noise makes: of a window with so little, half of what it says counts, and the less the plainer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Photograph:
    """An image that may be laid into others."""

    camera: Camera
    luminance: Float[np.ndarray, "h w"]
    """In [0, 1]. Arrays and gradients are of its precision."""
    usable: Bool[np.ndarray, "h w"]
    """Pixels that show nothing but the object."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenSurface:
    """A mesh as a photograph's camera sees it."""

    photograph: Photograph
    pixels: MeshPixels
    vertices: int
    """How many the mesh has."""
    planes: Float64[np.ndarray, "f 4"]
    """Unit normals of its faces in the camera's frame, and their product with what lies on the face."""
    farthest: Float32[np.ndarray, "h w"]
    """The largest depth around each pixel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Disagreement:
    """Of one photograph with another on a surface."""

    total: float
    """Sum of 1 - correlation, cut at ``_WORST``, over the windows of the first photograph, by their contrast."""
    judged: float
    """Sum of what they count."""
    gradient: Float64[np.ndarray, "v 3"]
    """Of the total by the vertices, in their frame."""


def look_at(photograph: Photograph, vertices: Vertices, faces: Faces) -> SeenSurface:
    """Draw a closed mesh, in the frame that the camera's pose leads from."""
    pixels = draw_mesh(vertices, faces, photograph.camera, closed=True)
    planes = np.empty((len(faces), 4))
    kernels.planes(photograph.camera.local(vertices), faces, planes)
    return SeenSurface(
        photograph=photograph,
        pixels=pixels,
        vertices=len(vertices),
        planes=planes,
        farthest=farthest_around(pixels.depth),
    )


def disagreement(first: SeenSurface, second: SeenSurface, faces: Faces, window: int, slack: float) -> Disagreement:
    """Compare windows of ``window`` by ``window`` pixels, an odd number, of the first photograph with what the second
    shows there.

    A place counts if the second camera sees it too: by depth, but for ``slack``. Without shared places, all is 0.
    """
    here, there = first.photograph, second.photograph
    image, kind = here.luminance, here.luminance.dtype
    laid, by_normal, shared = np.empty(image.shape, kind), np.empty(image.shape, kind), np.empty(image.shape, bool)
    rotation, shift = from_camera_to_camera(here.camera, there.camera)
    seen = first.pixels
    kernels.lay(
        seen.face, first.planes, lens_values(here.camera), here.usable, rotation, shift,
        lens_values(there.camera), there.luminance, there.usable, second.farthest, slack, _LEAST_COSINE,
        laid, by_normal, shared,
    )  # fmt: skip
    parts, slope, half = np.empty((*image.shape, 4), kind), np.empty(image.shape, kind), window // 2
    filled = _FILLED * window**2
    total, judged = kernels.correlate(image, laid, shared, half, filled, _NOISE**2, _WORST, parts)
    kernels.by_laid(image, laid, shared, half, parts, slope)
    local = np.zeros((first.vertices, 3))
    kernels.to_corners(slope, by_normal, seen.face, seen.weights, first.planes, faces, local)
    return Disagreement(
        total=total, judged=judged, gradient=local @ here.camera.world_to_camera.double().numpy()[:3, :3]
    )
