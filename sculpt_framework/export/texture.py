"""A texture baked from the photographs: for each texel, what the views that see it best show there."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from sculpt_framework.errors import ComponentImportError, ConfigError, DataError
from sculpt_framework.export.mesh_files import vertex_normals
from sculpt_framework.export.mesh_pixels import (
    cosines,
    draw_mesh,
    draw_triangles,
    kernels,
    lens_values,
    visibility_slack,
)
from sculpt_framework.types import View

_PADDING = 4
"""Texels between charts, half of which each may fill: what filtering of a smaller level still finds."""
_FLATTEST = 0.15
"""Least cosine at which a view counts: nearer the outline a small error of shape shows another part of the object."""
_TOLERANCE = 0.12
"""sRGB distance from the plain mean at which a view loses influence: highlights, and what hides the surface."""
_SIZES = (64, 16384)


@dataclass(frozen=True, kw_only=True, eq=False)
class Atlas:
    """A mesh cut into charts that lie side by side in the unit square; vertices on a cut are there once per chart."""

    source: Int64[np.ndarray, " w"]
    """The vertex of the mesh that each vertex is a copy of."""
    faces: Int64[np.ndarray, "f 3"]
    """In the order of the mesh's."""
    uv: Float64[np.ndarray, "w 2"]
    """From the lower left corner of the texture, as OBJ has it."""
    width: int
    height: int
    """Of the texture the charts were laid out for, in texels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Texture:
    rgb: Float32[np.ndarray, "h w 3"]
    """sRGB in [0, 1]; filled beyond the charts' borders."""
    seen_share: float
    """Of the charts' texels, those that some photograph shows."""


def unwrap(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"], size: int) -> Atlas:
    """Cut a mesh into charts for a texture of about ``size`` x ``size`` texels.

    Raises ComponentImportError where xatlas is not installed, ConfigError for a size out of range, DataError where the
    charts do not fit.
    """
    if not _SIZES[0] <= size <= _SIZES[1]:
        raise ConfigError(f"--texture-size is {size}; expected {_SIZES[0]} to {_SIZES[1]}.")
    try:
        import xatlas
    except ImportError as error:
        raise ComponentImportError(
            "a texture needs xatlas, which is not installed; pip install 'gaussian-sculpting[texture]', or leave "
            "--texture out for vertex colours."
        ) from error
    atlas, options = xatlas.Atlas(), xatlas.PackOptions()
    options.resolution, options.padding, options.bilinear, options.create_image = size, _PADDING, True, False
    atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    atlas.generate(xatlas.ChartOptions(), options)
    if atlas.atlas_count != 1:
        raise DataError(f"the mesh's charts do not fit a texture of {size} texels; give a larger --texture-size.")
    source, triangles, uv = atlas.get_mesh(0)
    return Atlas(
        source=source.astype(np.int64),
        faces=triangles.astype(np.int64),
        uv=np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float64),
        width=int(atlas.width),
        height=int(atlas.height),
    )


def bake(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    atlas: Atlas,
    views: Sequence[View],
    colors: Float[np.ndarray, "v 3"],
) -> Texture:
    """The texture of a mesh in world frame from views of it; ``colors`` of the vertices where no view sees it.

    A texel's colour is a mean over the views in which nothing hides it, weighted by how frontal and how near they are,
    and by how well they agree with the plain mean over the same views, which a first pass takes: the best view alone
    may be the one with a highlight. Memory: one view at a time.
    """
    inside, points, normals, plain = _texels(vertices, faces, atlas, colors)
    mean, known = plain.astype(np.float64), np.zeros(len(points), bool)
    slack = visibility_slack(vertices)
    for tolerance in (0.0, _TOLERANCE):
        sums, weight = np.zeros((len(points), 3)), np.zeros(len(points))
        for view in views:
            camera = view.camera
            frontal = cosines(points, normals, camera, draw_mesh(vertices, faces, camera).depth, slack)
            kernels.gather(
                points,
                frontal,
                camera.world_to_camera.double().numpy(),
                lens_values(camera),
                view.rgb.numpy(),
                _trusted(view),
                mean,
                tolerance,
                _FLATTEST,
                sums,
                weight,
            )
        known = weight > 0
        mean[known] = sums[known] / weight[known, None]
    image = np.zeros((atlas.height, atlas.width, 3), np.float32)
    image[inside] = mean
    return Texture(rgb=_padded(image, inside), seen_share=float(known.mean()))


def _texels(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    atlas: Atlas,
    colors: Float[np.ndarray, "v 3"],
) -> tuple[Bool[np.ndarray, "h w"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Which texels lie in a chart; and of those, in row order, the place, unit normal and vertex colour."""
    places = atlas.uv * (atlas.width, -atlas.height) + (0, atlas.height)
    drawn = draw_triangles(places, np.ones(len(places)), atlas.faces, atlas.width, atlas.height)
    inside = drawn.face >= 0
    normals = vertex_normals(vertices, faces)
    values = np.concatenate([vertices, normals, colors], axis=1)
    found = drawn.interpolate(faces, values)[inside]
    points, normal = np.ascontiguousarray(found[:, :3]), found[:, 3:6]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return inside, points, np.ascontiguousarray(normal / np.maximum(length, 1e-12)), found[:, 6:]


def _trusted(view: View) -> Float32[np.ndarray, "h w"]:
    """1 at pixels that show the object alone: a pixel of the outline shows what is behind it, too."""
    if view.alpha is None:
        return np.ones((view.camera.height, view.camera.width), np.float32)
    full = (view.alpha.numpy() > 0.98).astype(np.float32)
    return np.asarray(cv2.erode(full, np.ones((3, 3), np.uint8), borderValue=1), np.float32)


def _padded(image: Float32[np.ndarray, "h w 3"], inside: Bool[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 3"]:
    """Texels outside the charts take the colour of the nearest inside, so that no filter mixes in anything else."""
    if inside.all() or not inside.any():
        return image
    outside = (~inside).astype(np.uint8)
    _, labels = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    labels = np.asarray(labels, np.int64)
    source = np.zeros(int(labels.max()) + 1, np.int64)
    source[labels[inside]] = np.flatnonzero(inside)
    return image.reshape(-1, 3)[source[labels]]
