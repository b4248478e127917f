"""Free Gaussians behind the object (3DGS: Kerbl et al. 2023), whose number stays as it is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor, nn

from sculpt_framework.backgrounds import Background
from sculpt_framework.errors import DataError
from sculpt_framework.free_gaussians.config import GaussianRates
from sculpt_framework.free_gaussians.splats import NEIGHBOURS, Splats, spacing
from sculpt_framework.types import Box, Camera, Gaussians, View
from sculpt_framework.volume_rendering.pixels import rays_at
from sculpt_plugins.backgrounds.gaussians.config import GaussiansBackgroundConfig

_FAR = 4.0
"""The shell's distance from the middle of the object, in distances of the farthest camera."""
_OPACITY = 0.7
"""To begin with."""
_LARGEST = 4.0
"""In medians of the sizes of its kind: a stray point has no blob for a neighbourhood."""
_RATES = GaussianRates(means=4e-4)


class FreeBackground(Background):
    def __init__(self, config: GaussiansBackgroundConfig, device: torch.device):
        self._config, self._device = config, device
        self._splats: Splats | None = None

    @property
    def around(self) -> float:
        return self._config.around

    def begin(
        self,
        views: Sequence[View],
        box: Box,
        points: Float64[np.ndarray, "n 3"] | None,
        generator: torch.Generator,
    ) -> None:
        random = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
        moved = [(view, box.camera_to_object(view.camera)) for view in views]
        known = np.zeros((0, 3)) if points is None else box.to_object(torch.from_numpy(points)).numpy()
        near = _beside(known[random.permutation(len(known))[: 4 * self._config.near]], moved)
        parts = [near.first(self._config.near), _shell(moved, self._config.far, random)]
        means = np.concatenate([part.means for part in parts])
        if len(means) == 0:
            raise DataError("--background gaussians: the photographs show nothing but the object; leave it out.")
        colors = torch.from_numpy(np.concatenate([part.colors for part in parts])).float()
        sizes = torch.from_numpy(np.concatenate([_sizes(part.means) for part in parts])).float()
        places, turns = torch.from_numpy(means).float(), torch.eye(4)[:1].repeat(len(means), 1)
        scales = sizes[:, None].repeat(1, 3)
        self._splats = Splats.at(places, scales, turns, colors, _OPACITY, 0, _RATES, self._device)

    @property
    def _begun(self) -> Splats:
        assert self._splats is not None, "it has begun"  # noqa: S101
        return self._splats

    def gaussians(self) -> Gaussians:
        return self._begun.gaussians(1)

    @property
    def parameters(self) -> list[nn.Parameter]:
        return [] if self._splats is None else list(self._splats.parameters.values())

    def zero_grad(self) -> None:
        self._begun.zero_grad()

    def step(self, rate_factor: float) -> None:
        self._begun.step(rate_factor, rate_factor)

    def state(self) -> dict[str, Tensor]:
        return {} if self._splats is None else self._splats.state()

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        self._splats = Splats.of_state({name: value.to(self._device) for name, value in state.items()}, _RATES)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Places:
    """With the colours that views show there."""

    means: Float64[np.ndarray, "n 3"]
    colors: Float64[np.ndarray, "n 3"]

    def first(self, count: int) -> "_Places":
        return _Places(means=self.means[:count], colors=self.colors[:count])


def _beside(points: Float64[np.ndarray, "n 3"], views: Sequence[tuple[View, Camera]]) -> _Places:
    """Those that more views show beside the object than on it, in the mean colour of the former."""
    sums, beside, on = np.zeros((len(points), 3)), np.zeros(len(points)), np.zeros(len(points))
    for view, camera in views:
        pixels = camera.project(points)
        shown = np.flatnonzero(camera.shows(pixels))
        columns = pixels[shown, 0].astype(int).clip(max=camera.width - 1)
        rows = pixels[shown, 1].astype(int).clip(max=camera.height - 1)
        covered = np.zeros(len(shown), bool) if view.alpha is None else view.alpha.numpy()[rows, columns] > 0
        on[shown[covered]] += 1
        free = shown[~covered]
        beside[free] += 1
        sums[free] += view.rgb.numpy()[rows[~covered], columns[~covered]]
    kept = beside > on
    return _Places(means=points[kept], colors=sums[kept] / beside[kept, None])


def _shell(views: Sequence[tuple[View, Camera]], count: int, random: np.random.Generator) -> _Places:
    """Far away along the rays of pixels beside the object, as many of each view."""
    centers = [camera.position.double().numpy() for _, camera in views]
    radius = _FAR * max(float(np.linalg.norm(center)) for center in centers)
    means, colors = [], []
    for (view, camera), center in zip(views, centers, strict=True):
        share = random.integers(0, (camera.height, camera.width), size=(-(-count // len(views)), 2))
        if view.alpha is not None:
            share = share[view.alpha.numpy()[share[:, 0], share[:, 1]] == 0]
        numbers = torch.from_numpy(share @ (camera.width, 1))
        ray = rays_at(camera.to(torch.device("cpu"), torch.float64), numbers).directions.numpy()
        # Where the ray leaves the sphere, which the camera is inside of.
        along = ray @ center
        reach = -along + np.sqrt(along**2 + radius**2 - center @ center)
        means.append(center + reach[:, None] * ray)
        colors.append(view.rgb.numpy()[share[:, 0], share[:, 1]].astype(float))
    return _Places(means=np.concatenate(means), colors=np.concatenate(colors))


def _sizes(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """By the nearest neighbours; those of a point without any are of no account."""
    if len(points) <= NEIGHBOURS:
        return np.full(len(points), 1e-2)
    distances = spacing(points)
    return distances.clip(1e-6, _LARGEST * np.median(distances))
