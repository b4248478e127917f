from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import FieldConfig

if TYPE_CHECKING:
    import torch

    from sculpt_plugins.fields.mlp.field import MlpField


@dataclass(frozen=True, kw_only=True)
class MlpFieldConfig(FieldConfig):
    """The paper's field: a deep MLP with skip connection, positional encoding and geometric initialisation."""

    hidden_layers: int = 8
    """Layers of hidden units (paper: 8 fully connected layers)."""
    hidden_units: int = 256
    """Units per hidden layer (paper: 256)."""
    skip_layer: int = 4
    """Hidden layer that sees the encoded input again, counted from 0."""
    frequencies: int = 6
    """Octaves of the positional encoding."""
    features: int = 0
    """Length of the feature vector beside the distance."""
    softplus_beta: float = 100.0
    """Sharpness of the softplus between layers."""
    sphere_radius: float = 0.5
    """Radius of the sphere the field starts as, in object units."""
    learning_rate: float = 1e-3
    """Adam's rate before the schedule (paper: 1e-4)."""

    def build(self, device: "torch.device") -> "MlpField":
        from sculpt_plugins.fields.mlp.field import MlpField

        return MlpField(self).to(device)
