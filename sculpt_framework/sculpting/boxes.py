"""Boxes of the object frame that a user gives, in which the surface is frozen, or not taught by images."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int64
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from sculpt_framework.errors import CheckpointError, ConfigError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.fields import Field
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.geometry.octree_policy import extent
from sculpt_framework.types import Box, Surface


def object_box(name: str, low: Sequence[float], high: Sequence[float], scene_box: Box) -> Box:
    """The box between two corners, which a user gave in world frame, in the object frame.

    Raises ConfigError, which calls it by ``name``, if it misses the scene's box.
    """
    corners = torch.tensor([low, high], dtype=torch.float64)
    if bool((corners[0] >= scene_box.maximum).any() | (corners[1] <= scene_box.minimum).any()):
        numbers = [f"{number:g}" for number in (*low, *high)]
        bounds = [f"{number:.4g}" for number in (*scene_box.minimum.tolist(), *scene_box.maximum.tolist())]
        raise ConfigError(f"{name} {' '.join(numbers)} lies outside the object's box, which is {' '.join(bounds)}")
    minimum, maximum = scene_box.to_object(corners)
    return Box(minimum=minimum, maximum=maximum)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrozenField:
    """A box with the field as it was when it was frozen."""

    box: Box
    field: Field
    detail: float
    """What the field was told by ``set_detail``."""


def freeze(box: Box, field: Field, detail: float) -> FrozenField:
    """Keep the field's values in the box, whatever it learns from now on."""
    copy = deepcopy(field)
    for parameter in copy.parameters():
        parameter.requires_grad_(False)
    return FrozenField(box=box, field=copy, detail=detail)


def write_frozen(path: Path, frozen: FrozenField) -> None:
    """Raises OutputError if the file cannot be written."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in frozen.field.state_dict().items()}
    write_atomically(path, save(tensors, metadata={"detail": repr(frozen.detail)}))


def read_frozen(path: Path, box: Box, field: Field) -> FrozenField:
    """Inverse of ``write_frozen``; ``field`` is one of the same make. Raises CheckpointError for a damaged file."""
    try:
        with safe_open(path, framework="pt") as file:
            detail = float((file.metadata() or {})["detail"])
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
        frozen = freeze(box, field, detail)
        frozen.field.load_state_dict(state)
    except (SafetensorError, OSError, KeyError, ValueError, RuntimeError) as error:
        raise CheckpointError(f"{path} is damaged and cannot be read ({error})") from error
    frozen.field.set_detail(detail)
    return frozen


def signed_distance(
    field: Field, frozen: Sequence[FrozenField], points: Float[Tensor, "n 3"], margin: float
) -> Float[Tensor, " n"]:
    """The field's values; in frozen boxes those it had, with a smooth passage of width ``margin`` inside the walls.

    Without the passage the two would meet at the wall in a step as high as the surface has moved.
    """
    sdf = field(points)
    for each in frozen:
        share = (each.box.depth(points) / margin).clamp(0, 1)
        inside = share > 0
        if not bool(inside.any()):
            continue
        share = share[inside]
        share = share * share * (3 - 2 * share)
        kept = each.field(points[inside]).detach()
        sdf = sdf.index_put((inside.nonzero()[:, 0],), kept * share + sdf[inside] * (1 - share))
    return sdf


def within(boxes: Sequence[Box], points: Float[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Which points lie in any of the boxes."""
    inside = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    for box in boxes:
        inside |= box.depth(points) > 0
    return inside


def frozen_rows(frozen: Sequence[FrozenField], grid: Grid, keys: Int64[Tensor, " n"]) -> Bool[Tensor, " n"] | None:
    """Of cells and corners of the grid, or of an octree over it, those in frozen boxes; None if nothing is frozen."""
    if not frozen:
        return None
    return within([each.box for each in frozen], extent(grid, keys)[0])


def untaught(boxes: Sequence[Box], surface: Surface) -> Surface:
    """The same surface, without gradient to vertices in the boxes."""
    if not boxes:
        return surface
    vertices = surface.vertices
    inside = within(boxes, vertices.detach())
    return replace(surface, vertices=torch.where(inside[:, None], vertices.detach(), vertices))
