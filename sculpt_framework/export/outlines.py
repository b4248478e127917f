"""Masks from a surface: what of each image it covers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from sculpt_framework.export.mesh_pixels import Faces, Vertices, draw_mesh
from sculpt_framework.threads import in_threads
from sculpt_framework.types import View

_FINER = 3
"""Rays along the side of a pixel."""


def covered_by(vertices: Vertices, faces: Faces, views: Sequence[View]) -> list[View]:
    """The views with the share of each pixel that the mesh covers as alpha. Mesh and cameras in the same frame."""

    def covered(view: View) -> View:
        camera = view.camera
        fine = camera.resized(_FINER * camera.width, _FINER * camera.height)
        drawn = draw_mesh(vertices, faces, fine).face >= 0
        shares = drawn.reshape(camera.height, _FINER, camera.width, _FINER).mean(axis=(1, 3), dtype=np.float32)
        return replace(view, alpha=torch.from_numpy(shares))

    return in_threads(covered, views)
