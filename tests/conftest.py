import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

import pytest


class KernelFinder:
    """Finds modules of numba kernels before the shape checker does: it would wrap what numba is about to compile."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not name.startswith(("sculpt_framework.", "sculpt_plugins.")):
            return None
        spec = PathFinder.find_spec(name, path, target)
        is_source = spec is not None and spec.origin is not None and spec.origin.endswith(".py")
        return spec if is_source and "from numba import" in Path(spec.origin).read_text(encoding="utf-8") else None


sys.meta_path.insert(0, KernelFinder())


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-snapshots", action="store_true", help="write the stored texts anew instead of comparing")
