"""A view beside what a run makes of it, for the report."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.pictures import (
    Picture,
    color_picture,
    difference_picture,
    error_colors,
    normal_picture,
)
from sculpt_framework.losses import TrainingImage
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.sculpting.gaussian_scene import GaussianScene
from sculpt_framework.sculpting.reconstruction import face_centers, object_gaussians
from sculpt_framework.types import Box, Gaussians, Surface

RESULT = "Result"
"""Heading of what a run ended with."""
ERROR_LIMIT = 0.01
"""Share of the reference's diagonal at which the distance of a face has the strongest colour."""


class Album:
    """What one view shows of a run, at its start and now."""

    def __init__(
        self,
        rasterizer: Rasterizer,
        image: TrainingImage,
        box: Box,
        reference: MeasuredMesh | None,
        low_pass_px2: float,
    ):
        self._rasterizer = rasterizer
        self._image = image
        self._box = box
        self._reference = reference
        self._low_pass_px2 = low_pass_px2
        self._first: dict[str, Picture] = {}

    def begin(self, scene: GaussianScene, surface: Surface) -> None:
        """Keep pictures of the surface training starts from."""
        self._first = self._taken(scene, surface)

    def pages(self, scene: GaussianScene, surface: Surface) -> dict[str, dict[str, Picture]]:
        """Pictures by the state they show, under names for people: the surface the scene's rows are on, and the first,
        unless ``begin`` was never called."""
        out = {RESULT: {**image_picture(self._image), **self._taken(scene, surface)}}
        return out | {"Before training": self._first} if self._first else out

    def _taken(self, scene: GaussianScene, surface: Surface) -> dict[str, Picture]:
        errors = None if self._reference is None else face_errors(surface, self._box, self._reference)
        gaussians = object_gaussians(scene, surface)
        return view_pictures(self._rasterizer, gaussians, self._image, self._low_pass_px2, errors)


def image_picture(image: TrainingImage) -> dict[str, Picture]:
    """What a run was to reproduce, on white, under a name for people."""
    white = torch.ones(3).to(image.premultiplied)
    return {f"reference image ({image.name})": color_picture(image.over(white).rgb.cpu().numpy())}


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceErrors:
    """How far the middle of each face is from the reference."""

    shares: Float[np.ndarray, " f"]
    """Of ``limit``."""
    limit: float
    """World units."""


def face_errors(surface: Surface, box: Box, reference: MeasuredMesh) -> FaceErrors:
    """Distances of a surface in the object frame to a reference in world frame."""
    limit = ERROR_LIMIT * reference.mesh.diagonal
    squared, _ = reference.squared_distances(face_centers(surface, box))
    return FaceErrors(shares=np.sqrt(squared) / limit, limit=limit)


@torch.no_grad()
def view_pictures(
    rasterizer: Rasterizer,
    gaussians: Gaussians,
    image: TrainingImage,
    low_pass_px2: float,
    errors: FaceErrors | None,
) -> dict[str, Picture]:
    """Rendering, its difference from the image, normals, and where ``errors`` of the faces are given, those as colours.

    On white, under names for people.
    """
    white = torch.ones(3).to(image.premultiplied)
    rendering = rasterizer.render(gaussians, image.camera, white, low_pass_px2=low_pass_px2, normals=True)
    assert rendering.normal is not None, "normals were asked for"  # noqa: S101
    seen, made = image.over(white).rgb.cpu().numpy(), rendering.rgb.cpu().numpy()
    out = {
        "rendering": color_picture(made),
        "difference from the reference image": difference_picture(made, seen),
        "normals, world frame": normal_picture(rendering.normal.cpu().numpy()),
    }
    if errors is not None:
        colors = _shaded_errors(errors, gaussians, image)
        drawn = rasterizer.rasterize(
            gaussians.means,
            gaussians.scales,
            gaussians.rotations,
            gaussians.opacities,
            colors,
            image.camera,
            white,
            low_pass_px2=low_pass_px2,
            alpha_max=0.999,
        )
        name = f"mesh error: grey none, darkest from {errors.limit:.2g} scene units on"
        out[name] = color_picture(drawn.features.cpu().numpy())
    return out


def _shaded_errors(errors: FaceErrors, gaussians: Gaussians, image: TrainingImage) -> Float[Tensor, "g 3"]:
    """Colours of errors, a little darker where the surface turns away, so that its shape can be seen."""
    colors = torch.from_numpy(error_colors(errors.shares)).to(gaussians.means)[gaussians.face]
    towards = torch.nn.functional.normalize(image.camera.position.to(gaussians.means) - gaussians.means, dim=1)
    facing = (towards * gaussians.rotations[:, :, 0]).sum(dim=1, keepdim=True).abs()
    return colors * (0.6 + 0.4 * facing)
