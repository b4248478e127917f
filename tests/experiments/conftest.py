import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from sculpt_framework.experiments.ledger import CellState
from sculpt_framework.experiments.matrix import Budget, Cell, Matrix
from sculpt_framework.experiments.runner import Board

HERE = Path(__file__).parent
FAKE_TRAIN = (sys.executable, "-S", str(HERE / "fake_train.py"))


class SilentBoard(Board):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.waiting: list[str] = []
        self.settled: list[str] = []
        self.said: list[str] = []
        self.ends: dict[str, CellState] = {}

    def begin(self, waiting: Sequence[Cell], settled: Mapping[str, CellState]) -> None:
        self.waiting, self.settled = [cell.name for cell in waiting], list(settled)

    def warming_up(self, scene: str) -> None:
        self.said.append(f"warming up {scene}")

    def warned(self, message: str) -> None:
        self.said.append(message)

    def started(self, cell: Cell, resumed: bool) -> None:
        self.said.append(f"{'resumed' if resumed else 'started'} {cell.name}")

    def ended(self, cell: Cell, state: CellState) -> None:
        self.ends[cell.name] = state


@pytest.fixture
def board() -> SilentBoard:
    return SilentBoard()


@pytest.fixture
def make_matrix() -> Callable[..., Matrix]:
    """``make_matrix(0, 10, timed=True)``: cells named ``s<seed>`` of these seeds for the fake command."""

    def make(*seeds: int, timed: bool = False, warm: bool = False) -> Matrix:
        budget = Budget(kind="seconds" if timed else "steps", amount=5.0)
        cells = tuple(
            Cell(
                name=f"scene/s{seed}",
                scene="scene",
                setting="default",
                budget=budget,
                seed=seed,
                words=("method", "--data", "scene", *budget.words, "--seed", str(seed)),
            )
            for seed in seeds
        )
        return Matrix(title="Test", cells=cells, warm_ups={"scene": ("method", "--data", "scene")} if warm else {})

    return make


@pytest.fixture
def fake_command(monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """The fake in the place of sculpt-train."""
    monkeypatch.setattr("sculpt_framework.experiments.runner.TRAIN", FAKE_TRAIN)
    return FAKE_TRAIN


def started(folder: Path) -> list[str]:
    """The command lines that were started in an experiment's folder."""
    path = folder / "started.txt"
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []
