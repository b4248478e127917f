"""Boxes in which the surface is treated otherwise while a run goes on: frozen, or not taught by images."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int64
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.fields import Field
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.octree_policy import extent
from sculpt_framework.types import Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """An axis-aligned box in the object frame."""

    minimum: Float[Tensor, " 3"]
    maximum: Float[Tensor, " 3"]

    def depth(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Distance to the nearest wall, positive inside, negative outside (there a lower bound in size)."""
        low, high = self.minimum.to(points), self.maximum.to(points)
        return torch.minimum(points - low, high - points).amin(dim=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Frozen:
    """A region with the field as it was when it was frozen."""

    region: Region
    field: Field
    detail: float
    """What the field was told by ``set_detail``."""


def freeze(region: Region, field: Field, detail: float) -> Frozen:
    """Keep the field's values in the region, whatever it learns from now on."""
    copy = deepcopy(field)
    for parameter in copy.parameters():
        parameter.requires_grad_(False)
    return Frozen(region=region, field=copy, detail=detail)


def write_frozen(path: Path, frozen: Frozen) -> None:
    """Raises OutputError if the file cannot be written."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in frozen.field.state_dict().items()}
    write_atomically(path, save(tensors, metadata={"detail": repr(frozen.detail)}))


def read_frozen(path: Path, region: Region, field: Field) -> Frozen:
    """Inverse of ``write_frozen``; ``field`` is one of the same make. Raises CheckpointError for a damaged file."""
    try:
        with safe_open(path, framework="pt") as file:
            detail = float((file.metadata() or {})["detail"])
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
        frozen = freeze(region, field, detail)
        frozen.field.load_state_dict(state)
    except (SafetensorError, OSError, KeyError, ValueError, RuntimeError) as error:
        raise CheckpointError(f"{path} is damaged and cannot be read ({error})") from error
    frozen.field.set_detail(detail)
    return frozen


def signed_distance(
    field: Field, frozen: Sequence[Frozen], points: Float[Tensor, "n 3"], margin: float
) -> Float[Tensor, " n"]:
    """The field's values; in frozen regions those it had, with a smooth passage of width ``margin`` inside the walls.

    Without the passage the two would meet at the wall in a step as high as the surface has moved.
    """
    sdf = field(points)
    for each in frozen:
        share = (each.region.depth(points) / margin).clamp(0, 1)
        inside = share > 0
        if not bool(inside.any()):
            continue
        share = share[inside]
        share = share * share * (3 - 2 * share)
        kept = each.field(points[inside]).detach()
        sdf = sdf.index_put((inside.nonzero()[:, 0],), kept * share + sdf[inside] * (1 - share))
    return sdf


def within(regions: Sequence[Region], points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Which points lie in any of the regions."""
    inside = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    for region in regions:
        inside |= region.depth(points) > 0
    return inside


def frozen_rows(frozen: Sequence[Frozen], grid: Grid, keys: Int64[Tensor, " n"]) -> Bool[Tensor, " n"] | None:
    """Of cells and corners of the grid, or of an octree over it, those in frozen regions; None if nothing is frozen."""
    if not frozen:
        return None
    return within([each.region for each in frozen], extent(grid, keys)[0])


def untaught(regions: Sequence[Region], surface: Surface) -> Surface:
    """The same surface, without gradient to vertices in the regions."""
    if not regions:
        return surface
    vertices = surface.vertices
    inside = within(regions, vertices.detach())
    return replace(surface, vertices=torch.where(inside[:, None], vertices.detach(), vertices))
