import gc
import os
import sys
import time
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

import pytest

# Several workers of pytest-xdist share the cores: threads of their own would wait for one another at every barrier.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")


class KernelFinder:
    """Finds modules of kernels before the shape checker does: it would wrap what numba or Triton will compile."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not name.startswith(("sculpt_framework.", "sculpt_plugins.")):
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        source = Path(spec.origin).read_text(encoding="utf-8")
        return spec if "from numba import" in source or "@triton.jit" in source else None


sys.meta_path.insert(0, KernelFinder())


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files from the first and from the last in turn: two workers in one folder would compile the same kernels."""
    files = list(dict.fromkeys(item.path for item in items))
    rest = files[::-1]
    turns = dict.fromkeys(file for pair in zip(files, rest, strict=True) for file in pair)
    place = {file: index for index, file in enumerate(turns)}
    items.sort(key=lambda item: place[item.path])


def pytest_collection_finish() -> None:
    """Collected tests outlive every garbage collection: to look through them takes a twentieth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def few_samples() -> None:
    """Runs of a second begin and are measured with fewer points than results deserve, which would take three.

    And small pictures of demo objects are rendered at once, not reduced from some with five times as many rays.
    """
    from sculpt_framework.demo_scenes import tracing
    from sculpt_framework.evaluation import evaluator
    from sculpt_framework.shape_from_images import field_fit

    evaluator.CURVE_SAMPLES, evaluator.RESULT_SAMPLES = 1_000, 4_000
    field_fit.SAMPLES = 4_000
    tracing.FINEST = 96


@pytest.fixture
def time_passes(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """``time_passes(seconds)``: the clock goes on by so much at once, and nobody waits."""
    clock, passed = time.monotonic, [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock() + sum(passed))
    return passed.append
