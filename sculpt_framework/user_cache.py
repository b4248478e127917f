"""Where this package keeps what can be made again: compiled kernels, rendered scenes."""

import os
from pathlib import Path


def user_cache() -> Path:
    """The user's folder for it, below XDG_CACHE_HOME where that is set; it need not exist."""
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(base) if base else Path.home() / ".cache") / "gaussian-sculpting"
