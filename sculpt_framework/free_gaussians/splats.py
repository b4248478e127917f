"""Free Gaussians as parameters, and how they multiply (3DGS: Kerbl et al. 2023)."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.spatial import KDTree
from torch import Tensor, nn

from sculpt_framework.adam import Adam
from sculpt_framework.export.gaussian_files import rotations_from_quaternions
from sculpt_framework.free_gaussians.config import DensityConfig, GaussianRates
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.parameters import ParameterGroup, state_below
from sculpt_framework.rendering.spherical_harmonics import BAND_0
from sculpt_framework.types import Camera, Gaussians

_OPACITY = 0.1
"""To begin with (3DGS, program)."""
_SPLIT = 1.6
"""A Gaussian that is split leaves two, smaller by this (3DGS, 5.2)."""
_FLAT = 1e-6
"""Object units: the thickness of a disk."""
NEIGHBOURS = 3
"""To begin with, a Gaussian is as large as these are far."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Worth:
    """What decides of Gaussians' number in place of what they have themselves."""

    opacities: Float[Tensor, " g"]
    """In place of their own."""
    pull: Float[Tensor, " g"]
    """Added to the mean pull in the image, in half images."""


def spacing(points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """How far the nearest ``NEIGHBOURS`` of each are, in the mean; infinite where there are not so many."""
    return KDTree(points).query(points, k=NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)


class Splats:
    """Parameters of any number of Gaussians in the object frame, their optimiser, and what decides of their number."""

    def __init__(
        self, values: Mapping[str, Tensor], rates: GaussianRates, own_rates: Mapping[str, float] | None = None
    ):
        """``own_rates`` are the learning rates, by name, of what each learns beside 3DGS."""
        rate = {
            "means": rates.means,
            "log_scales": rates.scales,
            "quaternions": rates.rotations,
            "logits": rates.opacities,
            "constant": rates.colors,
            "rest": rates.colors / 20,
        }
        self._rates, self._own_rates = rates, dict(own_rates or {})
        rate |= self._own_rates
        self.parameters = {name: nn.Parameter(values[name].detach().clone()) for name in rate}
        groups = [ParameterGroup(parameters=[self.parameters[name]], rate=rate[name]) for name in rate]
        # The means have a rate that falls by itself, and so an optimiser of their own.
        self.means_optimizer, self.optimizer = Adam(groups[:1]), Adam(groups[1:])
        self.pull = torch.zeros(len(self), device=self.means.device)
        """Sum of the gradients' lengths by the place in the image since the number was last changed."""
        self.shown = torch.zeros(len(self), device=self.means.device)
        """How many renderings they are of."""

    @staticmethod
    def at_random(
        half_sides: Float[Tensor, " 3"],
        count: int,
        sh_degree: int,
        rates: GaussianRates,
        generator: torch.Generator,
        *,
        flat: bool = False,
    ) -> "Splats":
        """Grey, uniform in the box around the origin and in how they are turned; disks where they are ``flat``."""
        means = (2 * torch.rand(count, 3, generator=generator) - 1) * half_sides.float().cpu()
        scales = torch.from_numpy(spacing(means.numpy())).float().clamp(min=1e-6)[:, None].repeat(1, 3)
        if flat:
            scales[:, 2] = _FLAT
        turns = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
        grey = torch.full((count, 3), 0.5)
        return Splats.at(means, scales, turns, grey, _OPACITY, sh_degree, rates, half_sides.device)

    @staticmethod
    def at(
        means: Float[Tensor, "g 3"],
        scales: Float[Tensor, "g 3"],
        turns: Float[Tensor, "g 4"],
        colors: Float[Tensor, "g 3"],
        opacity: float,
        sh_degree: int,
        rates: GaussianRates,
        device: torch.device,
    ) -> "Splats":
        """At these places, of these standard deviations, turned by these quaternions, each of one colour."""
        values = {
            "means": means,
            "log_scales": scales.log(),
            "quaternions": turns,
            "logits": torch.full((len(means),), opacity).logit(),
            "constant": ((colors - 0.5) / BAND_0)[:, None],
            "rest": torch.zeros(len(means), (sh_degree + 1) ** 2 - 1, 3),
        }
        return Splats({name: value.to(device) for name, value in values.items()}, rates)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def means(self) -> nn.Parameter:
        return self.parameters["means"]

    @property
    def own(self) -> Mapping[str, Tensor]:
        """What each learns beside 3DGS."""
        return {name: self.parameters[name] for name in self._own_rates}

    def owning(self, values: Mapping[str, Tensor], rates: Mapping[str, float]) -> "Splats":
        """The same, to begin with, where each learns these as well."""
        return Splats({**self.parameters, **values}, self._rates, rates)

    def gaussians(self, bands: int) -> Gaussians:
        """With so many coefficients of the harmonics."""
        scales, turns = self.parameters["log_scales"].exp(), self.parameters["quaternions"]
        # As those bound to faces have it, column 0 is along the thinnest axis; the covariance is the same.
        order = scales.detach().argsort(dim=1)
        length = turns.norm(dim=1, keepdim=True)
        rotations = rotations_from_quaternions(turns / torch.where(length > 0, length, 1.0))
        return Gaussians(
            means=self.means,
            scales=scales.gather(1, order),
            rotations=rotations.gather(2, order[:, None].expand(-1, 3, -1)),
            opacities=self.parameters["logits"].sigmoid(),
            sh=torch.cat([self.parameters["constant"], self.parameters["rest"]], dim=1)[:, :bands],
            face=torch.full((len(self),), -1, dtype=torch.int64, device=self.means.device),
        )

    def note(self, camera: Camera) -> None:
        """Add the gradient that the means have from a rendering for this camera, as it is by places in half images.

        Across the line of sight, a step of z / f in space is one of a pixel; 3DGS takes the length in units in which
        the image is two wide.
        """
        slope = self.means.grad
        if slope is None:
            return
        pose = camera.world_to_camera.to(slope)
        across, depth = slope @ pose[:2, :3].T, self.means.detach() @ pose[2, :3] + pose[2, 3]
        size = slope.new_tensor([camera.width / (2 * camera.fx), camera.height / (2 * camera.fy)])
        length = (across * size).norm(dim=1) * depth.clamp(min=0)
        seen = slope.abs().amax(dim=1) > 0
        self.pull += torch.where(seen, length, 0.0)
        self.shown += seen

    def step(self, rate: float, means_rate: float) -> None:
        self.means_optimizer.step(means_rate)
        self.optimizer.step(rate)

    def zero_grad(self) -> None:
        self.means_optimizer.zero_grad()
        self.optimizer.zero_grad()

    def state(self) -> dict[str, Tensor]:
        values: dict[str, Tensor] = dict(self.parameters)
        values |= {f"means_optimizer.{name}": value for name, value in self.means_optimizer.state().items()}
        values |= {f"optimizer.{name}": value for name, value in self.optimizer.state().items()}
        return values | {"pull": self.pull, "shown": self.shown}

    @staticmethod
    def of_state(
        state: Mapping[str, Tensor], rates: GaussianRates, own_rates: Mapping[str, float] | None = None
    ) -> "Splats":
        splats = Splats(state, rates, own_rates)
        splats.means_optimizer.load_state(state_below(state, "means_optimizer."))
        splats.optimizer.load_state(state_below(state, "optimizer."))
        splats.pull, splats.shown = state["pull"].clone(), state["shown"].clone()
        return splats

    def after(
        self,
        taken: int,
        progress: float,
        config: DensityConfig,
        generator: torch.Generator,
        worth: "Callable[[Gaussians], Worth] | None" = None,
    ) -> "Splats":
        """Renewed and dimmed, where that is due after so many steps. Raises as ``renewed``."""
        splats = self
        if config.begin <= progress < config.end:
            if taken % config.every == 0:
                splats = splats.renewed(config, generator, worth)
            if config.reset_every and taken % config.reset_every == 0:
                splats = splats.dimmed(2 * config.least_opacity)
        return splats

    @torch.no_grad()
    def renewed(
        self, config: DensityConfig, generator: torch.Generator, worth: "Callable[[Gaussians], Worth] | None" = None
    ) -> "Splats":
        """What is left of them, and what is added: those that the images pull at are cloned where they are small, and
        split in two where they are large; what is nearly clear is dropped (3DGS, 5.2). ``worth`` says otherwise what
        each is worth.

        Raises EmptySurfaceError if none would be left.
        """
        mean = self.pull / self.shown.clamp(min=1)
        if worth is None:
            opaque = self.parameters["logits"].sigmoid() >= config.least_opacity
        else:
            said = worth(self.gaussians(1))
            opaque, mean = said.opacities >= config.least_opacity, mean + said.pull
        wanted = opaque & (mean >= config.gradient)
        if room := max(0, config.most - len(self)):
            # The strongest first, where there is not room for all.
            limit = mean.topk(min(room, len(self))).values.min()
            wanted &= mean >= limit
        else:
            wanted[:] = False
        scales = self.parameters["log_scales"].exp()
        large = scales.amax(dim=1) > config.large
        clones, splits = wanted & ~large, wanted & large
        kept = ~splits & opaque
        rows = torch.cat([kept.nonzero()[:, 0], clones.nonzero()[:, 0], splits.nonzero()[:, 0].repeat(2)])
        splats = self._at(rows, fresh=len(rows) - int(kept.sum()))
        values = splats.parameters
        if halves := 2 * int(splits.sum()):
            noise = torch.randn(halves, 3, generator=generator).to(scales)
            turns = values["quaternions"][-halves:]
            turned = rotations_from_quaternions(turns / turns.norm(dim=1, keepdim=True).clamp(min=1e-12))
            offset = torch.einsum("gij,gj->gi", turned, noise * scales[rows[-halves:]])
            values["means"][-halves:] += offset
            values["log_scales"][-halves:] -= torch.tensor(_SPLIT).log()
        return splats

    @torch.no_grad()
    def dimmed(self, most: float) -> "Splats":
        """Those that are more opaque than this are as opaque as this; the optimiser forgets how opacities moved (3DGS,
        5.2)."""
        logits = self.parameters["logits"].clamp(max=math.log(most / (1 - most)))
        splats = Splats({**self.parameters, "logits": logits}, self._rates, self._own_rates)
        splats.means_optimizer.load_state(self.means_optimizer.state())
        place = list(self.parameters).index("logits") - 1  # The means have an optimiser of their own.
        moments = {
            name: torch.zeros_like(value) if name.startswith(f"{place}.") and value.ndim else value
            for name, value in self.optimizer.state().items()
        }
        splats.optimizer.load_state(moments)
        splats.pull, splats.shown = self.pull, self.shown
        return splats

    @torch.no_grad()
    def without_clear(self, least_opacity: float) -> "Splats":
        """Those that are at least as opaque. Raises EmptySurfaceError if none is."""
        return self._at((self.parameters["logits"].sigmoid() >= least_opacity).nonzero()[:, 0], fresh=0)

    def _at(self, rows: Int64[Tensor, " n"], fresh: int) -> "Splats":
        """Those in these rows, of which so many at the end are new to the optimiser."""
        if len(rows) == 0:
            raise EmptySurfaceError("no Gaussian is left: all are nearly clear")
        splats = Splats(
            {name: parameter[rows] for name, parameter in self.parameters.items()}, self._rates, self._own_rates
        )
        new = torch.arange(len(rows), device=rows.device) >= len(rows) - fresh
        splats.means_optimizer.load_state(_rows(self.means_optimizer.state(), rows, new))
        splats.optimizer.load_state(_rows(self.optimizer.state(), rows, new))
        return splats


def _rows(state: Mapping[str, Tensor], rows: Int64[Tensor, " n"], fresh: Bool[Tensor, " n"]) -> dict[str, Tensor]:
    """An optimiser's state for these rows; what is new has no moments yet."""
    found = {}
    for name, value in state.items():
        if value.ndim == 0:
            found[name] = value
        else:
            found[name] = value[rows].clone()
            found[name][fresh] = 0
    return found
