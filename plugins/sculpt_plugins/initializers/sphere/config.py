from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import InitializerConfig

if TYPE_CHECKING:
    from sculpt_plugins.initializers.sphere.initializer import Sphere


@dataclass(frozen=True, kw_only=True)
class SphereConfig(InitializerConfig):
    """An ellipsoid in the object's box, shaped by silhouettes first (the paper's start)."""

    fill: float = 0.7
    """Its radii as a share of the box's half sides."""

    def build(self) -> "Sphere":
        from sculpt_plugins.initializers.sphere.initializer import Sphere

        return Sphere(self.fill)
