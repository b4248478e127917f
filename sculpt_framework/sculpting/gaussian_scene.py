"""The Gaussians of the current surface: rows that follow its faces, and what they look like when bound to it."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float, Int64
from scipy.spatial import KDTree
from torch import Tensor

from sculpt_framework.adam import Adam
from sculpt_framework.appearances import Appearance, bands
from sculpt_framework.binders import Binder, Binding, owning_faces
from sculpt_framework.geometry.band import levels_of
from sculpt_framework.geometry.grid import unpack_ijk
from sculpt_framework.keyed import KeyedTable
from sculpt_framework.types import Gaussians, Surface


class GaussianScene:
    """Owns the inner variables: the binder's and the appearance's rows under face keys, and the appearance's own
    parameters. Knows nothing of fields or extractors; a surface comes in, Gaussians come out."""

    def __init__(self, binder: Binder, appearance: Appearance):
        self.binder = binder
        self.appearance = appearance
        self.geometry_rows = KeyedTable(binder.rates)
        self.appearance_rows = KeyedTable(appearance.rates)
        groups = appearance.parameter_groups()
        self.shared_optimizer = Adam(groups) if groups else None
        self.blur = 0.0
        """Standard deviation of the screen's low-pass filter at the object, in object units; follows the images."""
        self._centroids: Float[Tensor, "f 3"] | None = None

    @property
    def learns_places(self) -> bool:
        """Whether the binder has anything to learn."""
        return any(rate > 0 for rate in self.geometry_rows.rates.values())

    @property
    def learning(self) -> list[Tensor]:
        """What learns: rows of both tables, and the appearance's own parameters."""
        return [*self.geometry_rows.learning, *self.appearance_rows.learning, *self.appearance.parameters()]

    def forget(self) -> None:
        """Drop all rows: the next surface starts with new Gaussians (paper: a cold start at every outer step)."""
        self.geometry_rows = KeyedTable(self.binder.rates)
        self.appearance_rows = KeyedTable(self.appearance.rates)
        self._centroids = None

    def follow(self, surface: Surface) -> None:
        """Carry the rows over to this surface's faces. Following the same surface again changes nothing."""
        surface = surface.detach()
        corners = surface.vertices[surface.faces]
        keys = surface.face_keys
        count, device, dtype = len(keys), corners.device, corners.dtype
        # Both tables have the same keys: they are looked up once.
        located = self.geometry_rows.locate(keys)
        self.geometry_rows.rekey(keys, self.binder.new_rows(count, device, dtype), located=located)
        centroids = corners.mean(dim=1)
        k = self.binder.gaussians_per_face
        new_rows = self.appearance.new_rows(centroids[:, None].expand(count, k, 3))
        if self.appearance.inherits_rows and self._centroids is not None:
            fresh = (~located[1]).nonzero()[:, 0]
            if len(fresh) > 0:
                lender = nearest_faces(self.appearance_rows.keys, self._centroids, keys[fresh], centroids[fresh])
                for name, rows in new_rows.items():
                    rows[fresh] = self.appearance_rows.leaves[name].detach()[lender]
        self.appearance_rows.rekey(keys, new_rows, located=located)
        self._centroids = centroids

    def rebind(self, binder: Binder) -> None:
        """Lay other Gaussians on the same faces: where the binder has them begin, in the mean colour of their face."""
        k, keys = binder.gaussians_per_face, self.appearance_rows.keys
        colors = {
            name: leaf.detach().mean(dim=1, keepdim=True).repeat_interleave(k, dim=1)
            for name, leaf in self.appearance_rows.leaves.items()
        }
        places = binder.new_rows(len(keys), keys.device, torch.float32)
        self.binder = binder
        self.geometry_rows, self.appearance_rows = KeyedTable(binder.rates), KeyedTable(self.appearance.rates)
        self.geometry_rows.rekey(keys, places)
        self.appearance_rows.rekey(keys, colors)

    def bind(self, surface: Surface, *, learn: bool) -> Binding:
        """Gaussians without colour; ``learn`` lets gradients reach the binder's rows."""
        rows = self.geometry_rows.leaves
        rows = rows if learn else {name: leaf.detach() for name, leaf in rows.items()}
        return self.binder.bind(surface, rows, blur=self.blur)

    def harmonics(self, means: Float[Tensor, "f k 3"], *, degree: int, learn: bool) -> Float[Tensor, "f k b 3"]:
        """Coefficients up to ``degree``; ``learn`` lets gradients reach rows and shared parameters."""
        with torch.set_grad_enabled(learn):
            sh = self.appearance(means.detach(), self.appearance_rows.leaves)
            return sh[:, :, : bands(min(degree, self.appearance.sh_degree))]

    def lower_sh_degree(self, degree: int) -> None:
        """Give up the bands above this one: their rows and all that learning keeps of them."""
        self.appearance.set_sh_degree(degree)
        self.appearance_rows.keep_only(self.appearance.rates)

    def zero_grad(self) -> None:
        self.geometry_rows.zero_grad()
        self.appearance_rows.zero_grad()
        if self.shared_optimizer is not None:
            self.shared_optimizer.zero_grad()

    def state(self) -> dict[str, Tensor]:
        """Rows and what is needed to carry them on, for a checkpoint; the appearance's own parameters excluded."""
        out = {f"geometry.{name}": value for name, value in self.geometry_rows.state().items()}
        out |= {f"appearance.{name}": value for name, value in self.appearance_rows.state().items()}
        out["sh_degree"] = torch.tensor(self.appearance.sh_degree)
        if self._centroids is not None:
            out["centroids"] = self._centroids
        return out

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``. Raises KeyError where an entry is missing."""
        self.appearance.set_sh_degree(int(state["sh_degree"]))
        self.appearance_rows.keep_only(self.appearance.rates)
        for prefix, table in (("geometry.", self.geometry_rows), ("appearance.", self.appearance_rows)):
            table.load_state({name[len(prefix) :]: value for name, value in state.items() if name.startswith(prefix)})
        self._centroids = state["centroids"].clone() if "centroids" in state else None

    def step(self, rate_factor: float) -> None:
        """One optimiser step on whatever has a gradient."""
        self.geometry_rows.step(rate_factor)
        self.appearance_rows.step(rate_factor)
        if self.shared_optimizer is not None:
            self.shared_optimizer.step(rate_factor)


def assemble(binding: Binding, sh: Float[Tensor, "f k b 3"]) -> Gaussians:
    """Flatten faces times K to Gaussians."""
    faces, k = binding.opacities.shape
    return Gaussians(
        means=binding.means.flatten(0, 1),
        scales=binding.scales.flatten(0, 1),
        rotations=binding.rotations.flatten(0, 1),
        opacities=binding.opacities.flatten(),
        sh=sh.flatten(0, 1),
        face=owning_faces(faces, k, binding.means.device),
    )


def as_leaves(gaussians: Gaussians) -> Gaussians:
    """The same values, cut off; those that a gradient can go on from collect one."""

    def leaf(value: Tensor) -> Tensor:
        return value.detach().requires_grad_(value.requires_grad)

    return Gaussians(
        means=leaf(gaussians.means),
        scales=leaf(gaussians.scales),
        rotations=leaf(gaussians.rotations),
        opacities=leaf(gaussians.opacities),
        sh=leaf(gaussians.sh),
        face=gaussians.face,
    )


def tensor_pairs(first: Gaussians, second: Gaussians) -> list[tuple[Tensor, Tensor]]:
    """What two sets of Gaussians have, tensor by tensor."""
    return [
        (first.means, second.means),
        (first.scales, second.scales),
        (first.rotations, second.rotations),
        (first.opacities, second.opacities),
        (first.sh, second.sh),
    ]


def nearest_faces(
    old_keys: Int64[Tensor, " m"],
    old_centroids: Float[Tensor, "m 3"],
    keys: Int64[Tensor, " n"],
    centroids: Float[Tensor, "n 3"],
) -> Int64[Tensor, " n"]:
    """Row of an old face near each new one.

    Keys sort by place, so the neighbour in key order usually lies in the same or the next cell along z; only where it
    does not is a search over all old faces worth its cost.
    """
    ordered, order = old_keys.sort()
    slot = torch.searchsorted(ordered, keys).clamp_(max=len(ordered) - 1)
    below = (slot - 1).clamp_(min=0)
    candidates: Sequence[Tensor] = (order[slot], order[below])
    distances = torch.stack([(old_centroids[c] - centroids).square().sum(dim=1) for c in candidates])
    lender = torch.where(distances[0] <= distances[1], candidates[0], candidates[1])
    apart = (unpack_ijk(old_keys[lender]) - unpack_ijk(keys)).abs().amax(dim=1) > 1
    far = apart | (levels_of(old_keys[lender]) != levels_of(keys))
    if bool(far.any()):
        _, found = KDTree(old_centroids.cpu().numpy()).query(centroids[far].cpu().numpy())
        lender[far] = torch.from_numpy(found).to(lender)
    return lender
