"""What is said while runs go on."""

import io

import pytest
from rich.console import Console

from sculpt_framework.experiments.board import ConsoleBoard
from sculpt_framework.experiments.ledger import CellState
from sculpt_framework.experiments.matrix import Budget, Cell


def cell(number: int, budget: Budget | None = None) -> Cell:
    return Cell(name=f"run-{number}", scene="s", setting="default", budget=budget, seed=number, words=())


def finished(seconds: float) -> CellState:
    return CellState(status="finished", attempts=1, seconds=seconds)


@pytest.fixture
def output() -> io.StringIO:
    return io.StringIO()


def make_board(output: io.StringIO, jobs: int = 1, terminal: bool = False) -> ConsoleBoard:
    console = Console(file=output, force_terminal=terminal, width=100)
    return ConsoleBoard(console, lambda cell: f"result of {cell.name}", jobs)


def test_the_time_that_is_left_follows_from_runs_that_ended(output: io.StringIO):
    cells = [cell(number) for number in range(5)]
    board = make_board(output)
    board.begin(cells, {})
    assert board.left() == ""
    for each, seconds in zip(cells, (10.0, 400.0, 20.0), strict=False):
        board.started(each, False)
        board.ended(each, finished(seconds))
    assert board.left() == "about 40 s left", "twice the median"
    board.started(cells[3], False)
    board.ended(cells[3], CellState(status="failed", seconds=1.0, error="no"))
    assert board.left() == "about 20 s left", "a failure is no measure of a run"
    board.started(cells[4], False)
    board.ended(cells[4], finished(5.0))
    assert board.left() == ""
    assert output.getvalue().splitlines()[1] == "[2/5] run-1: result of run-1 (7 min); about 10 min left"
    assert output.getvalue().splitlines()[3] == "[4/5] run-3: failed: no (1 s); about 20 s left"


def test_runs_of_so_many_seconds_are_expected_to_take_them(output: io.StringIO):
    board = make_board(output, jobs=2)
    board.begin([cell(number, Budget(kind="seconds", amount=3600.0)) for number in range(8)], {})
    assert board.left() == "about 4.0 h left"


def test_what_was_done_before_is_told(output: io.StringIO):
    board = make_board(output)
    board.begin([cell(2)], {"run-0": finished(1.0), "run-1": CellState(status="failed")})
    board.started(cell(2), True)
    board.ended(cell(2), finished(3.0))
    assert output.getvalue().splitlines() == [
        "2 of 3 runs were done before, 1 of them failed (--retry-failed runs those again).",
        "run-2 goes on from its checkpoint",
        "[3/3] run-2: result of run-2 (3 s)",
    ]


def test_a_terminal_has_a_bar(output: io.StringIO):
    board = make_board(output, terminal=True)
    board.begin([cell(0), cell(1)], {})
    board.started(cell(0), False)
    board.ended(cell(0), finished(7.0))
    board.close()
    text = output.getvalue()
    assert "1/2" in text
    assert "about 7 s left" in text
