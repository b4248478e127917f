from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import InitializerConfig
from sculpt_framework.ranges import above

if TYPE_CHECKING:
    from sculpt_plugins.initializers.sphere.initializer import Sphere


@dataclass(frozen=True, kw_only=True)
class SphereConfig(InitializerConfig):
    """An ellipsoid in the object's box, shaped by silhouettes first (the paper's start)."""

    fill: Annotated[float, above(0, below=1)] = 0.7
    """Its radii as a share of the box's half sides."""

    def build(self) -> "Sphere":
        from sculpt_plugins.initializers.sphere.initializer import Sphere

        return Sphere(self.fill)
