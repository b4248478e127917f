from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from sculpt_framework.config import FieldConfig
from sculpt_framework.ranges import above, at_least, between, require_levels

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.fields.hash_grid.field import HashGridField


@dataclass(frozen=True, kw_only=True)
class HashGridFieldConfig(FieldConfig):
    """A multi-resolution hash grid on top of the distance to a sphere."""

    GONE: ClassVar = {
        "features_per_level": 2, "hidden_units": 0, "decoder_rate": 2e-3, "level_falloff": 1.0, "coarse_to_fine": True,
    }  # fmt: skip

    num_levels: Annotated[int | None, at_least(1)] = None
    """Levels, whose widths grow evenly from the coarsest to the finest. If not given, each level has half as many cells
    as the next finer one, so that one of them has the grid's own."""
    log2_table: Annotated[int, between(1, 31)] = 19
    """Entries per level at most, as a power of two; levels that fit are stored without collisions."""
    base_resolution: Annotated[int, at_least(1)] = 4
    """Cells across [-1, 1] at the coarsest level; without a number of levels, at least so many."""
    finest_resolution: Annotated[int | None, at_least(1)] = None
    """Cells across [-1, 1] at the finest level. If not given, twice as many as the finest grid of the run has: the last
    level is for boxes that are refined. A single level has the base resolution."""
    sphere_radius: Annotated[float, above(0)] = 0.5
    """Radius of the sphere the field starts as, in object units."""
    rate: Annotated[float, at_least(0)] = 4e-3
    """Learning rate of a level of the base resolution before the schedule. Those of finer levels fall with their cells'
    size."""

    def check(self, option: str) -> None:
        if self.finest_resolution is not None:
            require_levels(option, self.num_levels, self.base_resolution, self.finest_resolution)

    def build(self, cells: int, device: "torch.device") -> "HashGridField":
        from sculpt_plugins.fields.hash_grid.field import HashGridField

        return HashGridField(self, cells).to(device)
