"""Values on a dense regular grid of cell centres: small, used once at the start."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from sculpt_framework.geometry.signed_distance import SdfFunction

_CHUNK = 1 << 17


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

    def within(self, outer: SdfFunction, device: torch.device) -> SdfFunction:
        """What lies in the volume's shape and in ``outer`` as well, which may be known more exactly than in cells."""
        own = self.interpolator(device)

        def value(points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
            return torch.maximum(own(points), outer(points))

        return value


def whole_box(half_sides: tuple[float, float, float], cells: int) -> Volume:
    """All of the box around the origin is solid, in so many cells along its longest side."""
    cell = 2 * max(half_sides) / cells
    shape = [int(np.ceil(2 * side / cell)) for side in half_sides]
    origin = (-0.5 * shape[0] * cell, -0.5 * shape[1] * cell, -0.5 * shape[2] * cell)
    return Volume(values=np.full(shape, -1, np.float32), origin=origin, cell=cell)


def sample(
    function: SdfFunction,
    half_sides: tuple[float, float, float],
    cells: int,
    device: torch.device,
    *,
    block: Literal[2, 4] = 4,
) -> Volume:
    """A signed distance at the centres of cells that cover the box, ``cells`` of them along the longest side, and one
    more around.

    Blocks of so many cells along a side are looked at first. Away from the surface values are interpolated between
    centres four or two cells apart, so there may be no change of sign there: the function's size may be at most 1.2
    times the distance to its zero with blocks of four, 1.5 times with blocks of two.
    """
    cell = 2 * max(half_sides) / cells
    shape = [int(np.ceil(2 * side / cell)) + 2 for side in half_sides]
    origin = (-0.5 * shape[0] * cell, -0.5 * shape[1] * cell, -0.5 * shape[2] * cell)
    start = torch.tensor(origin, device=device) + 0.5 * cell
    # A lattice that blocks fill.
    blocks = [-(-(count - 1) // block) for count in shape]

    def at(places: Tensor, step: int) -> Tensor:
        points = start + cell * step * places
        return torch.cat([function(part) for part in points.split(_CHUNK)])

    values = at(torch.cartesian_prod(*(torch.arange(n + 1, device=device) for n in blocks)), block)
    values, step = values.reshape([n + 1 for n in blocks]), block
    while step > 1:
        # Half the diagonal of a block to the nearest corner that is known, and a cell beside the surface.
        near = _blocks_near(values, (0.5 * 3**0.5 * step + 1) * cell)
        values = functional.interpolate(
            values[None, None], [2 * n - 1 for n in values.shape], mode="trilinear", align_corners=True
        )[0, 0]
        step //= 2
        wanted = functional.max_pool3d(
            functional.interpolate(near[None, None], scale_factor=2.0), kernel_size=2, stride=1, padding=1
        )[0, 0]
        places = wanted.nonzero()
        values[tuple(places.T)] = at(places, step)
    inside = values[: shape[0], : shape[1], : shape[2]]
    return Volume(values=np.ascontiguousarray(inside.cpu().numpy(), np.float32), origin=origin, cell=cell)


def _blocks_near(values: Float[Tensor, "x y z"], reach: float) -> Float[Tensor, "x2 y2 z2"]:
    """1 for the blocks between eight lattice points whose values come within ``reach`` of 0, or lie on both sides."""
    highest = functional.max_pool3d(values[None, None], kernel_size=2, stride=1)[0, 0]
    lowest = -functional.max_pool3d(-values[None, None], kernel_size=2, stride=1)[0, 0]
    return ((lowest < reach) & (highest > -reach)).to(values.dtype)


def signed_distance(
    inside: Bool[np.ndarray, "x y z"], level: Float32[np.ndarray, "x y z"], cell: float
) -> Float32[np.ndarray, "x y z"]:
    """Distance to the surface of ``inside``, negative there; ``level`` says where between cells its zero lies.

    ``level`` may have any scale: within 1.5 cells of the surface it is divided by the length of its gradient. Where its
    sign is not that of ``inside``, and further away, the distance is that between centres of cells.
    """
    if inside.all() or not inside.any():
        return np.where(inside, -1, 1).astype(np.float32)
    outer = np.asarray(ndimage.distance_transform_edt(~inside))
    inner = np.asarray(ndimage.distance_transform_edt(inside))
    far = np.where(inside, 0.5 - inner, outer - 0.5) * cell
    slope = np.sqrt(sum(np.square(part) for part in np.gradient(level, cell)))
    near = np.clip(level / np.maximum(slope, 0.2), -1.5 * cell, 1.5 * cell)
    trusted = ((near < 0) == inside) & (np.abs(far) < 1.5 * cell)
    return np.where(trusted, near, far).astype(np.float32)
