from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import FieldConfig
from sculpt_framework.ranges import above, at_least

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.fields.dense_grid.field import DenseGridField


@dataclass(frozen=True, kw_only=True)
class DenseGridFieldConfig(FieldConfig):
    """Signed distances stored on a dense grid: the discrete SDF of the paper's ablation."""

    resolution: Annotated[int, at_least(2)] = 96
    """Cells across [-1, 1]; memory grows with its cube."""
    sphere_radius: Annotated[float, above(0)] = 0.5
    """Radius of the sphere the field starts as, in object units."""
    rate: Annotated[float, at_least(0)] = 1e-3
    """Learning rate before the schedule, in object units per step."""

    def build(self, cells: int, device: "torch.device") -> "DenseGridField":
        from sculpt_plugins.fields.dense_grid.field import DenseGridField

        return DenseGridField(self).to(device)
