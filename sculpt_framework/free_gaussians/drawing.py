"""How a method draws its Gaussians, and what it learns from a drawing."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.losses import Target, TrainingImage
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Box, Camera, Gaussians, Rendering

Terms = dict[str, Float[Tensor, ""]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Lesson:
    """One view to learn from."""

    camera: Camera
    background: Float[Tensor, " 3"]
    target: Target
    """Over that background."""
    progress: float
    """Share of the run that is done."""
    generator: torch.Generator
    """What is random follows it."""
    own: Mapping[str, Tensor] = field(default_factory=dict)
    """What each Gaussian learns beside 3DGS (``Drawing.own_values``), a row each."""


class Drawing(ABC):
    """Gaussians and camera in the object frame."""

    @abstractmethod
    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering: ...

    def begin(self, images: Sequence[TrainingImage]) -> None:
        """These are the images that are learned from: whoever compares views with one another keeps them."""
        return

    def own_rates(self) -> Mapping[str, float]:
        """Learning rates, by name, of what each Gaussian learns beside 3DGS."""
        return {}

    def own_values(self, gaussians: Gaussians) -> Mapping[str, Tensor]:
        """That of Gaussians as they start, a row each."""
        return {}

    def parameter_groups(self) -> Sequence[ParameterGroup]:
        """What is learned beside the Gaussians."""
        return ()

    @abstractmethod
    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        """What is learned from one view: the sum of these is the loss."""


class Splatting(Drawing):
    """By a rasterizer, as ellipsoids; the colour loss of 3DGS."""

    def __init__(self, rasterizer: Rasterizer, low_pass_px2: float, dssim: float):
        self._rasterizer, self._low_pass, self._dssim = rasterizer, low_pass_px2, dssim

    def draw(self, gaussians: Gaussians, camera: Camera, background: Float[Tensor, " 3"]) -> Rendering:
        return self._rasterizer.render(gaussians, camera, background, low_pass_px2=self._low_pass)

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        rendering = self.draw(gaussians, lesson.camera, lesson.background)
        return {"color": l1_dssim(rendering.rgb, lesson.target.rgb, self._dssim)}


def facing(normals: Float[Tensor, "g 3"], means: Float[Tensor, "g 3"], camera: Camera) -> Float[Tensor, "g 3"]:
    """Normals, turned round where they point away from the camera. The side is not differentiated."""
    away = ((means - camera.position.to(normals)) * normals).sum(dim=1, keepdim=True).detach() > 0
    return torch.where(away, -normals, normals)


@torch.no_grad()
def on_white(drawing: Drawing, gaussians: Gaussians, camera: Camera) -> Rendering:
    return drawing.draw(gaussians, camera, torch.ones(3, device=gaussians.means.device))


@torch.no_grad()
def colors_of_nearest(gaussians: Gaussians, box: Box, mesh: Mesh) -> Float[np.ndarray, "v 3"]:
    """Of a mesh's vertices, those of the nearest Gaussians, without what changes with the view."""
    points = box.to_object(torch.from_numpy(mesh.vertices)).numpy()
    nearest = KDTree(gaussians.means.cpu().numpy()).query(points)[1]
    rgb = sh_to_rgb(gaussians.sh[:, :1], gaussians.means, torch.zeros_like(gaussians.means[0])).clamp(0, 1)
    return rgb.cpu().numpy()[nearest]
