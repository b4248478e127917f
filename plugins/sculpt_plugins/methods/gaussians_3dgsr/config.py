"""Options of ``3dgsr``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from sculpt_framework.free_gaussians.config import GaussianRates
from sculpt_framework.guided_gaussians.config import GuidedGaussiansConfig
from sculpt_framework.ranges import above, at_least, require

if TYPE_CHECKING:
    from sculpt_plugins.methods.gaussians_3dgsr.guide import OpacityGuide


@dataclass(frozen=True, kw_only=True)
class Gaussians3dgsrConfig(GuidedGaussiansConfig):
    """3DGSR (Lyu et al. 2024): a Gaussian is as opaque as a bell of the field's value at its centre."""

    GONE: ClassVar = {
        "field_from": 0.0,
        "radiance": {
            "num_levels": 6, "log2_table": 17, "base_resolution": 8, "finest_resolution": 256, "hidden_units": 32,
            "rate": 1e-2, "decoder_rate": 2e-3,
        },
    }  # fmt: skip

    bell: Annotated[float, above(0)] = 10.0
    """The paper's beta, to begin with, per object unit: the bell is half as high at 1.76 / beta. It is learned."""
    bell_rate: Annotated[float, at_least(0)] = 3e-3
    """Learning rate of a tenth of its logarithm."""

    def check(self) -> None:
        super().check()
        resets, rate, usual = self.density.reset_every, self.rates.opacities, GaussianRates().opacities
        require(resets == 0, "density.reset-every", resets, "0, as opacities follow the field")
        require(rate == usual, "rates.opacities", rate, f"{usual:g}, as opacities follow the field and have no rate")

    def build_guide(self) -> "OpacityGuide":
        from sculpt_plugins.methods.gaussians_3dgsr.guide import OpacityGuide

        return OpacityGuide(self)
