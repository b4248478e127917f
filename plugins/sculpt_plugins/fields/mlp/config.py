from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import FieldConfig
from sculpt_framework.ranges import above, at_least, require

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.fields.mlp.field import MlpField


@dataclass(frozen=True, kw_only=True)
class MlpFieldConfig(FieldConfig):
    """The paper's field: a deep MLP with skip connection, positional encoding and geometric initialisation."""

    hidden_layers: Annotated[int, at_least(1)] = 8
    """Layers of hidden units (paper: 8 fully connected layers)."""
    hidden_units: Annotated[int, at_least(1)] = 256
    """Units per hidden layer (paper: 256)."""
    skip_layer: Annotated[int, at_least(0)] = 4
    """Hidden layer that sees the encoded input again, counted from 0."""
    frequencies: Annotated[int, at_least(0)] = 6
    """Octaves of the positional encoding."""
    softplus_beta: Annotated[float, above(0)] = 100.0
    """Sharpness of the softplus between layers."""
    sphere_radius: Annotated[float, above(0)] = 0.5
    """Radius of the sphere the field starts as, in object units."""
    rate: Annotated[float, at_least(0)] = 1e-3
    """Learning rate before the schedule (paper: 1e-4)."""

    def check(self, option: str) -> None:
        last = self.hidden_layers - 1
        require(
            self.skip_layer <= last, f"{option}.skip-layer", self.skip_layer, f"0 to {last}, one of the hidden layers"
        )
        if self.skip_layer > 0:
            encoded = 3 + 6 * self.frequencies
            require(
                self.hidden_units > encoded,
                f"{option}.hidden-units",
                self.hidden_units,
                f"more than {encoded}, the inputs with {option}.frequencies {self.frequencies}, which "
                f"{option}.skip-layer sees again",
            )

    def build(self, cells: int, device: "torch.device") -> "MlpField":
        from sculpt_plugins.fields.mlp.field import MlpField

        return MlpField(self).to(device)
