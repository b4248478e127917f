"""Gaussian Sculpting: posed images of one object in, a watertight mesh out.

    import sculpt_framework as sculpt

    scene = sculpt.load("demo")
    session = sculpt.Session(scene, sculpt.methods["gaussian-sculpting"](), max_time=120)
    for report in session:
        print(report.step, report.loss)
    session.mesh().to_trimesh()

What is named here is loaded when it is first used: the command line starts without torch.
"""

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sculpt_framework.api import (
        Box,
        Camera,
        Host,
        MethodConfig,
        Moment,
        PaintedMesh,
        Reconstructor,
        Report,
        Scene,
        Session,
        StepReport,
        View,
        load,
        methods,
    )

# Spinning OpenMP threads of torch and numba fight for the same cores: a render after a matmul was 4.5 times slower.
# The runtime reads this once, when the first of the two libraries is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
__all__ = [
    "Box",
    "Camera",
    "Host",
    "MethodConfig",
    "Moment",
    "PaintedMesh",
    "Reconstructor",
    "Report",
    "Scene",
    "Session",
    "StepReport",
    "View",
    "load",
    "methods",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from sculpt_framework import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
