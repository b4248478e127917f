"""What a surface is the zero level of."""

from collections.abc import Callable

from torch import Tensor

SdfFunction = Callable[[Tensor], Tensor]
"""Points "n 3" of the object frame to signed distances "n", negative inside, differentiable."""


class EmptySurfaceError(RuntimeError):
    """The signed distance has one sign wherever it was looked at: there is no surface to extract."""
