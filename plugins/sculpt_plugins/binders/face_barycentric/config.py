from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import BinderConfig
from sculpt_framework.ranges import above, at_least, between

if TYPE_CHECKING:
    from sculpt_plugins.binders.face_barycentric.binder import FaceBarycentricBinder


@dataclass(frozen=True, kw_only=True)
class FaceBarycentricConfig(BinderConfig):
    """K Gaussians per face at learnable barycentric coordinates, flat along the normal."""

    gaussians_per_face: Annotated[int, between(1, 12)] = 1
    """K, 1 to 12."""
    scale: Annotated[float, above(0)] = 0.6
    """Start of the tangential standard deviations, as a share of the reference radii; of those of an ellipse with the
    K-th part of the area with the Steiner reference."""
    reference: Literal["steiner", "edges"] = "steiner"
    """Reference radii: the triangle's Steiner circumellipse, or half of two edges (paper, eq. 2)."""
    normal_scale: Annotated[float, above(0)] = 1e-3
    """Standard deviation along the normal, the paper's epsilon, in object units."""
    fit_outline: bool = True
    """Set Gaussians below their faces and end them at sharp bends, so that their outline is the mesh's
    (docs/background/splat-surface.md); off: on the face (paper)."""
    places: Literal["learned", "fixed"] = "learned"
    """Learn where on their faces Gaussians lie, how large and how turned they are; or leave all that as it starts,
    which costs no rows."""
    opacity: Literal["fixed", "learnable"] = "fixed"
    """Fixed at theta (paper), or learned per Gaussian from there (ablation)."""
    theta: Annotated[float, above(0, below=1)] = 0.99
    """The opacity close to one."""
    barycentric_rate: Annotated[float, at_least(0)] = 1e-3
    """Learning rate of the barycentric logits."""
    scale_rate: Annotated[float, at_least(0)] = 5e-3
    """Learning rate of the logarithms of the scale ratios (3DGS: 0.005)."""
    rotation_rate: Annotated[float, at_least(0)] = 1e-3
    """Learning rate of the in-plane rotation, in radians (3DGS: 0.001); 0: the frame is the face's own."""
    opacity_rate: Annotated[float, at_least(0)] = 5e-2
    """Learning rate of the opacity logits, if learnable (3DGS: 0.05)."""

    def build(self) -> "FaceBarycentricBinder":
        from sculpt_plugins.binders.face_barycentric.binder import FaceBarycentricBinder

        return FaceBarycentricBinder(self)
