"""What the run looks like now, as "snapshot" events carry it: cheap to take, for others to work out."""

from dataclasses import dataclass

import torch
from jaxtyping import Int64
from torch import Tensor

from sculpt_framework.geometry.grid import Grid
from sculpt_framework.sculpting.reconstruction import object_gaussians
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.types import Box, Gaussians, Surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """Surface and Gaussians in the object frame of ``box``, on the device of the run. Read-only."""

    surface: Surface
    gaussians: Gaussians
    box: Box
    grid: Grid
    cells: Int64[Tensor, " c"]
    """Keys of the cells the surface passes through."""


@torch.no_grad()
def take_snapshot(trainer: BiLevelTrainer, box: Box) -> Snapshot | None:
    """The surface as of the latest extraction; None before the first, and after a return to an earlier state."""
    extraction = trainer.extraction
    if extraction is None:
        return None
    surface = extraction.surface.detach()
    return Snapshot(
        surface=surface,
        gaussians=object_gaussians(trainer.scene, surface),
        box=box,
        grid=extraction.grid,
        cells=extraction.cells,
    )
