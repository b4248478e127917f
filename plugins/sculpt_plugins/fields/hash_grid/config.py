from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import FieldConfig
from sculpt_framework.ranges import above, at_least, between, require

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.fields.hash_grid.field import HashGridField


@dataclass(frozen=True, kw_only=True)
class HashGridFieldConfig(FieldConfig):
    """A multi-resolution hash grid, with or without a small decoder, on top of the distance to a sphere."""

    num_levels: Annotated[int, at_least(1)] = 7
    """Levels of the grid."""
    features_per_level: Annotated[int, at_least(1)] = 2
    """Numbers stored per grid corner, where there is a decoder; else it is one."""
    log2_table: Annotated[int, between(1, 31)] = 19
    """Entries per level at most, as a power of two; levels that fit are stored without collisions."""
    base_resolution: Annotated[int, at_least(1)] = 4
    """Cells across [-1, 1] at the coarsest level."""
    finest_resolution: Annotated[int, at_least(1)] = 256
    """Cells across [-1, 1] at the finest level."""
    hidden_units: Annotated[int, at_least(0)] = 0
    """Units of the decoder's one hidden layer; 0: no decoder."""
    sphere_radius: Annotated[float, above(0)] = 0.5
    """Radius of the sphere the field starts as, in object units."""
    rate: Annotated[float, at_least(0)] = 4e-3
    """Learning rate of the table before the schedule, for the coarsest level."""
    decoder_rate: Annotated[float, at_least(0)] = 2e-3
    """Learning rate of the decoder's weights before the schedule, if there is a decoder."""
    level_falloff: Annotated[float, at_least(0)] = 1.0
    """Exponent by which a level's rate falls with its cell size: Adam moves all table entries at about one pace."""
    coarse_to_fine: bool = True
    """Wake levels up only when the extraction grid is fine enough to see them."""

    def check(self, option: str) -> None:
        fine, coarse = self.finest_resolution, self.base_resolution
        require(fine >= coarse, f"{option}.finest-resolution", fine, f"{option}.base-resolution ({coarse}) or more")

    def build(self, device: "torch.device") -> "HashGridField":
        from sculpt_plugins.fields.hash_grid.field import HashGridField

        return HashGridField(self).to(device)
