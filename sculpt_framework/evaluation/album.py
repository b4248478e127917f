"""A view beside what a run makes of it, for the report."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float32

from sculpt_framework.evaluation.evaluator import on_white
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.pictures import (
    Picture,
    color_picture,
    difference_picture,
    error_colors,
    normal_picture,
)
from sculpt_framework.export.mesh_pixels import MeshPixels, draw_mesh
from sculpt_framework.reconstructor import Reconstructor
from sculpt_framework.types import Camera, Rendering, View

RESULT = "Result"
"""Heading of what a run ended with."""
ERROR_LIMIT = 0.01
"""Share of the reference's diagonal at which the distance of a face has the strongest colour."""


class Album:
    """What one view shows of a run, at its start and now."""

    def __init__(self, view: View, reference: MeasuredMesh | None):
        self._view = view
        self._reference = reference
        self._first: dict[str, Picture] = {}

    def begin(self, method: Reconstructor) -> None:
        """Keep pictures of the surface training starts from."""
        self._first = self._taken(method)

    def pages(self, method: Reconstructor) -> dict[str, dict[str, Picture]]:
        """Pictures by the state they show, under names for people: as the method is now, and as it was first, unless
        ``begin`` was never called."""
        out = {RESULT: {**image_picture(self._view), **self._taken(method)}}
        return out | {"Before training": self._first} if self._first else out

    def _taken(self, method: Reconstructor) -> dict[str, Picture]:
        return view_pictures(method.render, method.mesh(), self._view, self._reference)


def image_picture(view: View) -> dict[str, Picture]:
    """What a run was to reproduce, on white, under a name for people."""
    return {f"reference image ({view.name})": color_picture(on_white(view).numpy())}


@torch.no_grad()
def view_pictures(
    render: Callable[[Camera], Rendering], mesh: Mesh, view: View, reference: MeasuredMesh | None
) -> dict[str, Picture]:
    """Rendering, its difference from the image, the mesh's normals and, where there is a reference, how far its faces
    are from that.

    On white, under names for people. All in world frame.
    """
    seen, made = on_white(view).numpy(), render(view.camera).rgb.cpu().numpy()
    drawn = draw_mesh(mesh.vertices, mesh.faces, view.camera)
    normals = mesh.area_vectors / np.maximum(mesh.areas, 1e-300)[:, None]
    out = {
        "rendering": color_picture(made),
        "difference from the reference image": difference_picture(made, seen),
        "normals, world frame": normal_picture(_at_pixels(drawn, normals.astype(np.float32), 0.0)),
    }
    if reference is not None:
        limit = ERROR_LIMIT * reference.mesh.diagonal
        colors = _shaded_errors(mesh, normals, reference, limit, view.camera)
        name = f"mesh error: grey none, darkest from {limit:.2g} scene units on"
        out[name] = color_picture(_at_pixels(drawn, colors, 1.0))
    return out


def _at_pixels(drawn: MeshPixels, values: Float32[np.ndarray, "f 3"], elsewhere: float) -> Float32[np.ndarray, "h w 3"]:
    """Values of faces at the pixels that show them."""
    out = np.full((*drawn.face.shape, 3), elsewhere, np.float32)
    seen = drawn.face >= 0
    out[seen] = values[drawn.face[seen]]
    return out


def _shaded_errors(
    mesh: Mesh, normals: np.ndarray, reference: MeasuredMesh, limit: float, camera: Camera
) -> Float32[np.ndarray, "f 3"]:
    """Colours of how far the middle of each face is from the reference, a little darker where the surface turns away,
    so that its shape can be seen."""
    middles = mesh.corners.mean(axis=1)
    squared, _ = reference.squared_distances(middles)
    towards = camera.position.double().numpy() - middles
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-300)
    facing = np.abs((towards * normals).sum(axis=1, keepdims=True))
    return (error_colors(np.sqrt(squared) / limit) * (0.6 + 0.4 * facing)).astype(np.float32)
