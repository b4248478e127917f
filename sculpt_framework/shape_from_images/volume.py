"""Values on a dense regular grid of cell centres: small, used once at the start."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor
from torch.nn import functional

from sculpt_framework.extractors import SdfFunction


@dataclass(frozen=True, kw_only=True, eq=False)
class Volume:
    values: Float32[np.ndarray, "x y z"]
    origin: tuple[float, float, float]
    """The corner of the first cell, in the object frame."""
    cell: float
    """Side of a cell, in object units."""

    @property
    def points(self) -> Float32[np.ndarray, "n 3"]:
        """Centres of the cells."""
        axes = [start + self.cell * (np.arange(n) + 0.5) for start, n in zip(self.origin, self.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.values.shape[0], self.values.shape[1], self.values.shape[2]

    @property
    def radius(self) -> float:
        """Of the ball around the origin that holds all cells with a value below 0."""
        solid = self.points[self.values.reshape(-1) < 0]
        return float(np.linalg.norm(solid, axis=1).max()) + self.cell if len(solid) else self.cell

    def holding(self, values: Float32[np.ndarray, "x y z"]) -> "Volume":
        return replace(self, values=values)

    def interpolator(self, device: torch.device) -> SdfFunction:
        """Trilinear interpolation between the centres; beyond them the nearest value."""
        values = torch.from_numpy(self.values).to(device)[None, None]
        start = torch.tensor(self.origin, device=device)
        size = self.cell * torch.tensor(self.shape, device=device)

        def value(points: Tensor) -> Tensor:
            unit = (2 * (points - start) / size - 1).flip(1)[None, None, None]
            return functional.grid_sample(
                values, unit.to(values.dtype), mode="bilinear", padding_mode="border", align_corners=False
            )[0, 0, 0, 0].to(points.dtype)

        return value


def sample(function: SdfFunction, half_sides: tuple[float, float, float], cells: int, device: torch.device) -> Volume:
    """A function at the centres of cells that cover the box, ``cells`` of them along the longest side, and one more
    around."""
    cell = 2 * max(half_sides) / cells
    shape = [int(np.ceil(2 * side / cell)) + 2 for side in half_sides]
    origin = (-0.5 * shape[0] * cell, -0.5 * shape[1] * cell, -0.5 * shape[2] * cell)
    empty = Volume(values=np.zeros(shape, np.float32), origin=origin, cell=cell)
    chunks = torch.from_numpy(empty.points).to(device).split(1 << 17)
    values = torch.cat([function(chunk).cpu() for chunk in chunks])
    return empty.holding(values.numpy().astype(np.float32).reshape(shape))
