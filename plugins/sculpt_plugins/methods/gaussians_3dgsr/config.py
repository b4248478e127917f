"""Options of ``3dgsr``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.guided_gaussians.config import GuidedGaussiansConfig
from sculpt_framework.ranges import above, at_least

if TYPE_CHECKING:
    from sculpt_plugins.methods.gaussians_3dgsr.guide import OpacityGuide


@dataclass(frozen=True, kw_only=True)
class Gaussians3dgsrConfig(GuidedGaussiansConfig):
    """3DGSR (Lyu et al. 2024): a Gaussian is as opaque as a bell of the field's value at its centre."""

    bell: Annotated[float, above(0)] = 10.0
    """The paper's beta, to begin with, per object unit: the bell is half as high at 1.76 / beta. It is learned."""
    bell_rate: Annotated[float, at_least(0)] = 3e-3
    """Learning rate of a tenth of its logarithm."""

    def build_guide(self) -> "OpacityGuide":
        from sculpt_plugins.methods.gaussians_3dgsr.guide import OpacityGuide

        return OpacityGuide(self)
