"""What a result was made with, so that it can be made again."""

import platform
from collections.abc import Mapping
from importlib import metadata

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
    """Versions of Python, of the system and of the packages that numbers depend on; None where one is not installed."""
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        **{name: _version(name) for name in PACKAGES},
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
