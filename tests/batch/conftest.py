import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FAKE_TRAIN = (sys.executable, "-S", str(HERE / "fake_train.py"))
BATCH = """
import sys
from sculpt_framework.experiments import runner
from sculpt_framework.cli import batch, exit_codes
runner.TRAIN = tuple(sys.argv[1].split("|"))
exit_codes.run(lambda: batch.batch(sys.argv[2:]))
"""
"""A program: sculpt-batch with the fake in the place of sculpt-train."""

MakeScenes = Callable[..., Path]


@pytest.fixture
def make_scenes(tmp_path: Path) -> MakeScenes:
    """``make_scenes("a", "b")``: a folder of scenes of these names."""

    def make(*names: str) -> Path:
        for name in names:
            (tmp_path / "scans" / name).mkdir(parents=True)
        return tmp_path / "scans"

    return make


def with_fake(*words: str) -> list[str]:
    """The command line of that program."""
    return [sys.executable, "-c", BATCH, "|".join(FAKE_TRAIN), *words]


def plain_environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "200", "NO_COLOR": "1"}


def started(folder: Path) -> list[str]:
    """The command lines that were started in a batch's folder."""
    path = folder / "started.txt"
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []
