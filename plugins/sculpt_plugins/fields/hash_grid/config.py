from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import FieldConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.fields.hash_grid.field import HashGridField


@dataclass(frozen=True, kw_only=True)
class HashGridFieldConfig(FieldConfig):
    """A multi-resolution hash grid, with or without a small decoder, on top of the distance to a sphere."""

    num_levels: int = 7
    """Levels of the grid."""
    features_per_level: int = 2
    """Numbers stored per grid corner, where there is a decoder; else it is one."""
    log2_table: int = 19
    """Entries per level at most, as a power of two; levels that fit are stored without collisions."""
    base_resolution: int = 4
    """Cells across [-1, 1] at the coarsest level."""
    finest_resolution: int = 256
    """Cells across [-1, 1] at the finest level."""
    hidden_units: int = 0
    """Units of the decoder's one hidden layer; 0: none, and no decoder either unless there are ``features``."""
    features: int = 0
    """Length of the feature vector beside the distance."""
    sphere_radius: float = 0.5
    """Radius of the sphere the field starts as, in object units."""
    learning_rate: float = 4e-3
    """Adam's rate of the table before the schedule, for the coarsest level."""
    decoder_rate: float = 2e-3
    """Adam's rate of the decoder's weights before the schedule, if there is a decoder."""
    level_falloff: float = 1.0
    """Exponent by which a level's rate falls with its cell size: Adam moves all table entries at about one pace."""
    coarse_to_fine: bool = True
    """Wake levels up only when the extraction grid is fine enough to see them."""

    def build(self, device: "torch.device") -> "HashGridField":
        from sculpt_plugins.fields.hash_grid.field import HashGridField

        return HashGridField(self).to(device)
