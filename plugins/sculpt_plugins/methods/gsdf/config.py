"""Options of ``gsdf``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.free_gaussians.config import long_after
from sculpt_framework.guided_gaussians.config import GuidedGaussiansConfig
from sculpt_framework.ranges import above, at_least, between
from sculpt_framework.volume_rendering.config import RadianceConfig

if TYPE_CHECKING:
    from sculpt_plugins.methods.gsdf.guide import MutualGuide


@dataclass(frozen=True, kw_only=True)
class GuidanceConfig:
    """Where rays look, and where Gaussians multiply."""

    reach: Annotated[float, above(0)] = 4.0
    """The paper's k: rays are looked at as far in front of and behind the Gaussians' depth as k times the distance that
    the field has there."""
    samples: Annotated[int, at_least(4)] = 24
    """Stretches of a ray within that reach."""
    sigma: Annotated[float, above(0)] = 0.1
    """Object units: how far from the field's zero Gaussians count as near it."""
    growing: Annotated[float, at_least(0)] = 5e-5
    """The paper's omega_g: what the pull at a Gaussian on the field's zero is raised by, in half images."""
    pruning: Annotated[float, at_least(0)] = 0.1
    """The paper's omega_p: what the opacity of a Gaussian far from it is lowered by, where it is asked if it stays."""


@dataclass(frozen=True, kw_only=True)
class GsdfConfig(GuidedGaussiansConfig):
    """GSDF (Yu et al. 2024): Gaussians say where rays look at a field; the field says where Gaussians multiply."""

    field_from: Annotated[float, between(0, 1)] = 0.0
    """Share of the run from which on the field learns; the Gaussians are alone before."""
    guidance: GuidanceConfig = GuidanceConfig()
    radiance: RadianceConfig

    def check(self) -> None:
        super().check()
        self.radiance.check("radiance")

    @property
    def alone_until(self) -> float:
        return self.field_from

    @property
    def stretches(self) -> tuple[float, ...]:
        """The field is a sphere when it begins to learn: such a state must not compete."""
        return (self.field_from, *long_after(self.field_from)) if self.field_from > 0 else ()

    @property
    def ray_colors(self) -> RadianceConfig:
        return self.radiance

    def build_guide(self) -> "MutualGuide":
        from sculpt_plugins.methods.gsdf.guide import MutualGuide

        return MutualGuide(self)
