"""Slot ``binder``: Gaussians on the faces of a surface (paper, 3.1 "Surface Gaussian Model")."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sculpt_framework.types import Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Binding:
    """K Gaussians on each face, before they have a colour. Differentiable in the surface and in the binder's rows."""

    means: Float[Tensor, "f k 3"]
    scales: Float[Tensor, "f k 3"]
    """Standard deviations along the columns of ``rotations``: normal, first and second tangent."""
    rotations: Float[Tensor, "f k 3 3"]
    opacities: Float[Tensor, "f k"]
    barycentrics: Float[Tensor, "f k 3"]
    tangent_covariance: Float[Tensor, "f k 2 2"]
    """Covariance in the face's own tangent frame (r1, r2), whatever in-plane rotation the Gaussian has."""
    tangent_corners: Float[Tensor, "f 3 2"]
    """The face's corners in the same tangent frame, origin at its centroid."""

    def detach(self) -> "Binding":
        return replace(self, **{field.name: getattr(self, field.name).detach() for field in fields(self)})


class Binder(ABC):
    """Places Gaussians on faces. What it learns is one row per face, relative to the face, so that a row stays
    meaningful while the face moves; the rows live in the trainer's KeyedTable under the face keys."""

    @property
    @abstractmethod
    def gaussians_per_face(self) -> int: ...

    def with_gaussians(self, per_face: int) -> "Binder":
        """The same with so many Gaussians on a face; itself, where it knows no other number."""
        return self

    @property
    @abstractmethod
    def rates(self) -> dict[str, float]:
        """Names of the row parameters with their learning rates in the inner loop."""

    @abstractmethod
    def new_rows(self, faces: int, device: torch.device, dtype: torch.dtype) -> dict[str, Tensor]:
        """Rows "f ..." that a face starts with."""

    @abstractmethod
    def bind(self, surface: Surface, rows: Mapping[str, Tensor], *, blur: float) -> Binding:
        """``blur`` is the standard deviation of the screen's low-pass filter at the object's distance, in object units:
        by how much every splat is wider than its Gaussian."""


def owning_faces(faces: int, gaussians_per_face: int, device: torch.device) -> Int64[Tensor, " g"]:
    """Index of the face of every Gaussian, in the order in which "f k" flattens."""
    return torch.arange(faces, device=device).repeat_interleave(gaussians_per_face)
