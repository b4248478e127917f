"""What a result was made with, so that it can be made again."""

import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

PACKAGES = (
    "gaussian-sculpting",
    "torch",
    "numpy",
    "numba",
    "scipy",
    "libigl",
    "trimesh",
    "opencv-contrib-python-headless",
)


def installed_versions() -> Mapping[str, str | None]:
    """Python, the machine and the packages that numbers and times depend on; None where something is not known."""
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        **{name: _version(name) for name in PACKAGES},
    }


def _processor() -> str | None:
    """The processor's model; platform knows it everywhere but on Linux."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or None
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), None)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
