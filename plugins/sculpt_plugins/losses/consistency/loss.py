"""Consistency between views (PGSR's and Geo-NeuS' idea, on the mesh itself)."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from sculpt_framework.export.mesh_pixels import visibility_slack
from sculpt_framework.losses import TrainingImage, ViewsLoss
from sculpt_framework.multi_view_stereo.agreement import Disagreement, Photograph, disagreement, look_at
from sculpt_framework.multi_view_stereo.stereo_views import LUMINANCE, compared_with
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Surface
from sculpt_plugins.losses.consistency.config import ConsistencyConfig

_CHOICE = 3
"""Times as many neighbours as are compared with in one step: they take turns."""


class Consistency(ViewsLoss):
    """Mean over the pixels of the masks, so that it weighs as much as the photometric term where all is judged.

    0, without a gradient, where no two views can be compared. Runs on the CPU whatever device the surface is on.
    """

    def __init__(self, config: ConsistencyConfig):
        self._config = config
        self._photographs: list[Photograph] = []
        self._pixels: list[int] = []
        """How many of each photograph are usable; 1 where none is."""
        self._neighbours: list[Int64[np.ndarray, " _"]] = []

    @property
    def views(self) -> int:
        return self._config.views

    def begin(self, images: Sequence[TrainingImage]) -> None:
        self._photographs = in_threads(_photograph, images)
        self._pixels = [max(1, int(each.usable.sum())) for each in self._photographs]
        positions = np.stack([each.camera.position.double().numpy() for each in self._photographs])
        self._neighbours = compared_with(positions.astype(np.float32), _CHOICE * self._config.partners)

    def __call__(self, surface: Surface, views: Sequence[int], step: int) -> Float[Tensor, ""]:
        partners = {view: self._partners(view, step) for view in views}
        pairs = [(view, other) for view in views for other in partners[view]]
        if not pairs:
            return surface.vertices.new_zeros(())
        vertices, faces = surface.vertices.detach().cpu().double().numpy(), surface.faces.cpu().numpy()
        used = sorted({number for pair in pairs for number in pair})
        drawn = in_threads(lambda number: look_at(self._photographs[number], vertices, faces), used)
        seen, slack = dict(zip(used, drawn, strict=True)), visibility_slack(vertices)

        def compare(pair: tuple[int, int]) -> Disagreement:
            return disagreement(seen[pair[0]], seen[pair[1]], faces, self._config.window, slack)

        # The mean of the views' means, so that shares of the views, in several processes, add up to the same.
        value, gradient = 0.0, np.zeros_like(vertices)
        for (view, _), found in zip(pairs, in_threads(compare, pairs), strict=True):
            share = 1 / (len(views) * len(partners[view]) * self._pixels[view])
            value += share * found.total
            gradient += share * found.gradient
        return _Known.apply(surface.vertices, value, gradient)

    def _partners(self, view: int, step: int) -> list[int]:
        """The neighbours whose turn it is."""
        others = self._neighbours[view]
        count = min(self._config.partners, len(others))
        return [int(others[(step * count + k) % len(others)]) for k in range(count)]


class _Known(torch.autograd.Function):
    """A value whose gradient by the vertices is known already."""

    @staticmethod
    def forward(ctx, vertices: Float[Tensor, "v 3"], value: float, gradient: Float64[np.ndarray, "v 3"]):
        ctx.save_for_backward(torch.from_numpy(gradient).to(vertices))
        return vertices.new_tensor(value)

    @staticmethod
    @once_differentiable
    def backward(ctx, arriving: Float[Tensor, ""]):
        (gradient,) = ctx.saved_tensors
        return arriving * gradient, None, None


def _photograph(image: TrainingImage) -> Photograph:
    rgb = image.premultiplied.cpu().numpy()
    inside = np.ones(rgb.shape[:2]) if image.alpha is None else image.alpha.cpu().numpy()
    # A sample takes pixels up to two away.
    usable = cv2.erode(
        (inside > 0.99).astype(np.uint8), np.ones((5, 5), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    camera = image.camera.to(torch.device("cpu"), image.camera.world_to_camera.dtype)
    return Photograph(camera=camera, luminance=(rgb @ LUMINANCE).astype(np.float32), usable=np.asarray(usable) > 0)
