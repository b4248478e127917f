"""Options of ``splatting-3d``."""

from dataclasses import dataclass

from sculpt_framework.free_gaussians.config import FreeGaussiansConfig


@dataclass(frozen=True, kw_only=True)
class Splatting3dConfig(FreeGaussiansConfig):
    """3DGS (Kerbl et al. 2023): Gaussians that are cloned, split and dropped; nothing holds them to a surface."""
