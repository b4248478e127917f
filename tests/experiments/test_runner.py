"""Runs are isolated from each other, survive interrupts, and are not done twice."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import HERE, SilentBoard, started

from sculpt_framework.engine.checkpoint import Progress, write_checkpoint
from sculpt_framework.errors import ConfigError, JobRefusedError, OutputError
from sculpt_framework.experiments.launching import Engine, Job, LocalEngine, Order
from sculpt_framework.experiments.ledger import CellState, Ledger
from sculpt_framework.experiments.matrix import Cell, Matrix, remember
from sculpt_framework.experiments.runner import ended_as, last_error, run_folder, run_matrix
from sculpt_framework.folder_lock import only_one

MakeMatrix = Callable[..., Matrix]
pytestmark = pytest.mark.usefixtures("fake_command")


def states(matrix: Matrix, folder: Path) -> dict[int, str]:
    ledger = Ledger(folder)
    return {cell.seed: ledger.get(cell.name).status for cell in matrix.cells}


def test_a_failure_stops_nothing_and_says_why(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    matrix = make_matrix(10, 0, 11, 12, 16, 1)
    ended = run_matrix(matrix, tmp_path, board)
    assert states(matrix, tmp_path) == {
        10: "failed",
        0: "finished",
        11: "failed",
        12: "failed",
        16: "failed",
        1: "finished",
    }
    assert ended["scene/s10"].error == "the data are no good"
    assert ended["scene/s10"].exit_code == 2
    assert ended["scene/s11"].error == "RuntimeError: a fault of ours"
    assert ended["scene/s12"].error == "killed by SIGKILL"
    assert ended["scene/s16"].error == "it left no metrics.json; the observer recorder has to be there"
    assert ended["scene/s0"].seconds is not None
    assert ended["scene/s0"].error is None
    assert ended == board.ends
    assert ended_as(run_folder(tmp_path, matrix.cells[1])) == "finished"


def test_what_has_ended_is_not_run_again(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    matrix = make_matrix(0, 10)
    first = run_matrix(matrix, tmp_path, board)
    again = SilentBoard()
    assert run_matrix(make_matrix(0, 10, 1), tmp_path, again) == {**first, "scene/s1": again.ends["scene/s1"]}
    assert again.waiting == ["scene/s1"]
    assert sorted(again.settled) == ["scene/s0", "scene/s10"]
    assert len(started(tmp_path)) == 3


def test_failures_are_tried_again_when_asked(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    matrix = make_matrix(0, 10)
    run_matrix(matrix, tmp_path, board)
    ended = run_matrix(matrix, tmp_path, board, retry_failed=True)
    assert ended["scene/s10"].attempts == 2
    assert ended["scene/s0"].attempts == 1
    assert (tmp_path / "runs" / "scene" / "s10.aside-1").is_dir()


def test_a_run_that_finished_though_the_runner_did_not_see_it_is_left_alone(
    make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path
):
    matrix = make_matrix(0)
    run_matrix(matrix, tmp_path, board)
    Ledger(tmp_path).set("scene/s0", CellState(status="running", attempts=1))
    run_matrix(matrix, tmp_path, board)
    assert states(matrix, tmp_path) == {0: "finished"}
    assert len(started(tmp_path)) == 1


RUNNER = """
import sys
sys.path.insert(0, sys.argv[1])
from conftest import FAKE_TRAIN, SilentBoard
from sculpt_framework.cli import exit_codes
from sculpt_framework.experiments.matrix import Budget, Cell, Matrix
from sculpt_framework.experiments.runner import run_matrix
from pathlib import Path
budget = Budget(kind=sys.argv[3], amount=5.0)
words = ("method", "--data", "scene", *budget.words, "--seed", "13")
cell = Cell(name="scene/s13", scene="scene", setting="default", budget=budget, seed=13, words=words)
matrix = Matrix(title="Test", cells=(cell,), warm_ups={})
exit_codes.run(lambda: run_matrix(matrix, Path(sys.argv[2]), SilentBoard(), command=FAKE_TRAIN))
"""


def interrupted_runner(folder: Path, kind: str, number: signal.Signals) -> int:
    """Run a matrix of one run that waits, in a process of its own, and send that a signal once the run is under way."""
    command = [sys.executable, "-c", RUNNER, str(HERE), str(folder), kind]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        deadline, before = time.monotonic() + 30, len(started(folder))
        while len(started(folder)) == before or not (folder / "runs" / "scene" / "s13" / "ready").exists():
            assert process.poll() is None, process.stderr and process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(number)
        # An unheard signal shows in the exit code: the run it was to stop ends by itself before this time is over.
        return process.wait(120)


@pytest.mark.slow
def test_an_interrupt_lets_runs_save_and_the_next_call_goes_on(
    make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path
):
    assert interrupted_runner(tmp_path, "steps", signal.SIGINT) == 130
    matrix = make_matrix(13)
    run_dir = run_folder(tmp_path, matrix.cells[0])
    assert ended_as(run_dir) == "stopped"
    assert states(matrix, tmp_path) == {13: "interrupted"}
    ended = run_matrix(matrix, tmp_path, board)
    assert ended["scene/s13"].status == "finished"
    assert ended["scene/s13"].attempts == 2
    assert started(tmp_path)[1] == f"--resume {run_dir}"
    assert board.said == ["resumed scene/s13"]


@pytest.mark.slow
def test_a_run_of_so_many_seconds_starts_again_from_the_beginning(make_matrix: MakeMatrix, tmp_path: Path):
    assert interrupted_runner(tmp_path, "seconds", signal.SIGTERM) == 130
    matrix = make_matrix(13, timed=True)
    assert states(matrix, tmp_path) == {13: "interrupted"}
    assert ended_as(run_folder(tmp_path, matrix.cells[0])) is None, "nothing to be saved: it is begun anew"
    assert interrupted_runner(tmp_path, "seconds", signal.SIGINT) == 130
    assert all("--resume" not in line for line in started(tmp_path))
    assert (tmp_path / "runs" / "scene" / "s13.aside-1" / "ready").exists()


def test_no_process_outlives_the_runner(tmp_path: Path):
    interrupted_runner(tmp_path, "steps", signal.SIGTERM)
    listing = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True, encoding="utf-8").stdout
    assert str(tmp_path) not in listing


def test_a_damaged_checkpoint_is_set_aside(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    matrix = make_matrix(15)
    assert run_matrix(matrix, tmp_path, board)["scene/s15"].status == "failed"
    Ledger(tmp_path).set("scene/s15", CellState(status="interrupted", attempts=1))
    assert run_matrix(matrix, tmp_path, board)["scene/s15"].status == "finished"
    assert "could not go on from its checkpoint" in " ".join(board.said)
    assert (tmp_path / "runs" / "scene" / "s15.aside-1" / "checkpoints").is_dir()


def test_a_checkpoint_is_kept_where_something_else_is_in_the_way(
    make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path
):
    matrix, run = make_matrix(17), tmp_path / "runs" / "scene" / "s17"
    assert run_matrix(matrix, tmp_path, board)["scene/s17"].status == "failed"
    begun = Progress(
        outer=1, progress=0.1, trained_seconds=1.0, best_psnr=None, rate_scale=1.0, recoveries=0, milestones=[]
    )
    write_checkpoint(run / "checkpoints", {}, begun)
    Ledger(tmp_path).set("scene/s17", CellState(status="interrupted", attempts=1))
    state = run_matrix(matrix, tmp_path, board)["scene/s17"]
    assert state.status == "failed"
    assert "there is none here today" in str(state.error)
    assert not list(run.parent.glob("*.aside-*"))
    assert (run / "checkpoints" / "latest.safetensors").stat().st_size > 0


def test_two_at_a_time_if_asked(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    (one,) = make_matrix(14).cells
    matrix = Matrix(title="Test", cells=(one, replace(one, name="scene/other")), warm_ups={})
    ended = run_matrix(matrix, tmp_path, board, jobs=2)
    assert {state.status for state in ended.values()} == {"finished"}


class Narrow(Engine):
    """Takes so many at a time, whatever it is given."""

    def __init__(self, most: int):
        self._most, self._jobs, self._local = most, list[Job](), LocalEngine(8)

    def start(self, order: Order) -> Job:
        if sum(job.poll() is None for job in self._jobs) >= self._most:
            raise JobRefusedError("the queue is full")
        self._jobs.append(self._local.start(order))
        return self._jobs[-1]

    def close(self) -> None:
        pass


def test_what_a_scheduler_refuses_waits_for_the_end_of_another(
    make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path
):
    ended = run_matrix(make_matrix(0, 1, 2, 10), tmp_path, board, jobs=4, engine=Narrow(2))
    assert [state.status for state in ended.values()] == ["finished"] * 3 + ["failed"]
    assert {state.attempts for state in ended.values()} == {1}
    refusals = [each for each in board.said if "has to wait until another run has ended: the queue is full" in each]
    assert len(refusals) == 1


def test_a_scheduler_that_takes_nothing_ends_the_matrix(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    with pytest.raises(ConfigError, match="the queue is full"):
        run_matrix(make_matrix(0, 1), tmp_path, board, jobs=2, engine=Narrow(0))
    assert states(make_matrix(0, 1), tmp_path) == {0: "pending", 1: "pending"}


def test_one_at_a_time_otherwise(make_matrix: MakeMatrix, tmp_path: Path):
    events: list[str] = []

    class Diary(SilentBoard):
        def started(self, cell: Cell, resumed: bool) -> None:
            events.append("started")

        def ended(self, cell: Cell, state: CellState) -> None:
            events.append("ended")

    run_matrix(make_matrix(0, 10, 1), tmp_path, Diary())
    assert events == ["started", "ended"] * 3


def test_warming_up_comes_first_and_leaves_nothing(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    matrix = make_matrix(0, 1, warm=True)
    run_matrix(matrix, tmp_path, board)
    lines = started(tmp_path)
    assert lines[0] == f"method --data scene --output {tmp_path / 'warm-up'}"
    assert len(lines) == 3
    assert not list(tmp_path.glob("warm-up*"))
    run_matrix(matrix, tmp_path, board)
    assert len(started(tmp_path)) == 3, "with nothing to run there is nothing to warm up for"


def test_a_failed_warm_up_is_told(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    matrix = make_matrix(0)
    bad = Matrix(title="Test", cells=matrix.cells, warm_ups={"scene": ("method", "--data", "scene", "--seed", "10")})
    assert run_matrix(bad, tmp_path, board)["scene/s0"].status == "finished"
    assert "the warm-up of scene failed: the data are no good" in board.said


def test_one_runner_at_a_time(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    with (
        only_one(tmp_path, "give another --out"),
        pytest.raises(ConfigError, match=r"another process works in .*--out"),
    ):
        run_matrix(make_matrix(0), tmp_path, board)
    run_matrix(make_matrix(0), tmp_path, board)


def test_results_of_another_question_are_refused(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    run_matrix(make_matrix(0), tmp_path, board)
    with pytest.raises(ConfigError, match=r"holds another experiment: scene/s0 was run there as 'sculpt-train method"):
        run_matrix(make_matrix(0, timed=True), tmp_path, board)
    remember(make_matrix(5), tmp_path)
    assert sorted(json.loads((tmp_path / "matrix.json").read_text(encoding="utf-8"))["cells"]) == [
        "scene/s0",
        "scene/s5",
    ]


@pytest.mark.parametrize(
    ("name", "content"), [("matrix.json", "[]"), ("matrix.json", "{"), ("state.json", '{"cells": 3}')]
)
def test_files_of_something_else_are_refused(
    name: str, content: str, make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path
):
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match="give another --out"):
        run_matrix(make_matrix(0), tmp_path, board)
    assert started(tmp_path) == []


def test_a_folder_that_cannot_be_made(make_matrix: MakeMatrix, board: SilentBoard, tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="give another --out"):
        run_matrix(make_matrix(0), tmp_path / "file" / "out", board)


def test_the_ledger_is_whole_after_every_change(make_matrix: MakeMatrix, tmp_path: Path):
    seen: list[dict[str, str]] = []

    class Reader(SilentBoard):
        def started(self, cell: Cell, resumed: bool) -> None:
            seen.append(
                {
                    n: s["status"]
                    for n, s in json.loads((tmp_path / "state.json").read_text(encoding="utf-8"))["cells"].items()
                }
            )

    run_matrix(make_matrix(0, 10), tmp_path, Reader())
    assert seen == [{"scene/s0": "running"}, {"scene/s0": "finished", "scene/s10": "running"}]


def test_jobs_share_the_cores(make_matrix: MakeMatrix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    show = (sys.executable, "-c", "import os, sys; sys.exit('threads ' + os.environ.get('OMP_NUM_THREADS', 'free'))")
    for jobs, expected in ((1, "threads free"), (10_000, "threads 1")):
        ended = run_matrix(make_matrix(0), tmp_path / str(jobs), SilentBoard(), jobs=jobs, command=show)
        assert ended["scene/s0"].error == expected


def test_the_last_error(tmp_path: Path):
    log = tmp_path / "log"
    for text, expected in (
        ("error: first\nmore\nerror: second\nbye\n", "second"),
        ("Traceback\n  File\nValueError: no\n", "ValueError: no"),
        ("", "it said nothing"),
    ):
        log.write_text(text, encoding="utf-8")
        assert last_error(log) == expected
    assert last_error(tmp_path / "none").startswith("no log")
