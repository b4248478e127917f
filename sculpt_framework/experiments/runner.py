"""Carries out a matrix: one process per run, as many at a time as asked, going on where an earlier call ended."""

import json
import shutil
import signal
import sys
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sculpt_framework.comparison.labels import ASIDE
from sculpt_framework.errors import CheckpointError, JobRefusedError, OutputError
from sculpt_framework.experiments.launching import Engine, Job, LocalEngine, Order, as_interrupt
from sculpt_framework.experiments.ledger import CellState, Ledger
from sculpt_framework.experiments.matrix import Cell, Matrix, remember
from sculpt_framework.folder_lock import only_one

TRAIN = (sys.executable, "-c", "from sculpt_framework.cli.train import main; main()")
"""``sculpt-train`` of this installation, whatever is first on the path."""
RUNS = "runs"
_POLL_SECONDS = 0.1
_GRACE_SECONDS = 60.0
"""How long an interrupted run may take to save."""
_LOG_TAIL = 1 << 16
_USER_ERROR = 2


class Board(ABC):
    """Is told what happens, to show it."""

    @abstractmethod
    def begin(self, waiting: Sequence[Cell], settled: Mapping[str, CellState]) -> None:
        """What is to be run, in this order, and what was before."""

    @abstractmethod
    def warming_up(self, scene: str) -> None: ...

    @abstractmethod
    def warned(self, message: str) -> None: ...

    @abstractmethod
    def started(self, cell: Cell, resumed: bool) -> None: ...

    @abstractmethod
    def ended(self, cell: Cell, state: CellState) -> None: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """A process at work on a cell."""

    cell: Cell
    job: Job
    log: Path
    began: float
    """``time.monotonic()``."""
    resumed: bool


def run_folder(folder: Path, cell: Cell) -> Path:
    """The run directory of a cell."""
    return folder / RUNS / cell.name


def run_matrix(
    matrix: Matrix,
    folder: Path,
    board: Board,
    *,
    jobs: int = 1,
    retry_failed: bool = False,
    retries: int = 0,
    command: Sequence[str] | None = None,
    engine: Engine | None = None,
) -> dict[str, CellState]:
    """Run every cell that has not ended yet, by ``command`` and the cell's words; returns what became of each.

    ``engine`` starts the processes, ``jobs`` at a time; None: on this machine. The caller closes the one it gives.

    A finished run is left as it is. One that was interrupted goes on from its checkpoint; if it is given wall seconds,
    or cannot go on, what there is of it is renamed aside and it starts again. A run that failed is a result and stays
    so, unless ``retry_failed``. A failure stops nothing else. A run that was killed, or ended by a fault of ours, is
    tried ``retries`` times again, from its checkpoint where it has one; one that was refused for a user's error is
    not.

    On KeyboardInterrupt (or SIGTERM, SIGHUP) the running processes are stopped, the ledger is true, and the interrupt
    goes on to the caller. Raises ConfigError where the folder belongs to another matrix or process, OutputError where
    it cannot be written, JobRefusedError where the engine takes no run though none is at work.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}; give another --out.") from error
    with only_one(folder, "give another --out"), as_interrupt(_ends()):
        remember(matrix, folder)
        ledger = Ledger(folder)
        settled = {cell.name: state for cell in matrix.cells if (state := _settled(folder, cell, ledger, retry_failed))}
        for name, state in settled.items():
            if ledger.get(name) != state:
                ledger.set(name, state)
        waiting = deque(cell for cell in matrix.cells if cell.name not in settled)
        board.begin(tuple(waiting), settled)
        command, engine = command or TRAIN, engine or LocalEngine(jobs)
        for scene in dict.fromkeys(cell.scene for cell in waiting):
            _warm_up(matrix, scene, folder, board, command, engine)
        _work_off(waiting, folder, ledger, board, jobs, retries, command, engine)
        return {cell.name: ledger.get(cell.name) for cell in matrix.cells}


def ended_as(run_dir: Path) -> str | None:
    """How a run ended by its own account: finished, stopped or failed; None if it has not."""
    try:
        status = json.loads((run_dir / "metrics.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return status if isinstance(status, str) else None


def _settled(folder: Path, cell: Cell, ledger: Ledger, retry_failed: bool) -> CellState | None:
    """The state of a cell that need not run any more; None if it must."""
    state = ledger.get(cell.name)
    if ended_as(run_folder(folder, cell)) == "finished":
        return replace(state, status="finished", error=None, exit_code=0)
    return state if state.status == "failed" and not retry_failed else None


def _work_off(
    waiting: deque[Cell],
    folder: Path,
    ledger: Ledger,
    board: Board,
    jobs: int,
    retries: int,
    command: Sequence[str],
    engine: Engine,
) -> None:
    running: list[Attempt] = []
    left = {cell.name: retries for cell in waiting}
    refused = told = False
    try:
        while waiting or running:
            while waiting and len(running) < jobs and not refused:
                cell = waiting.popleft()
                try:
                    running.append(_start(cell, folder, ledger, command, engine))
                except JobRefusedError as error:
                    if not running:
                        raise
                    # What runs is worth more than what waits: it is handed in again when there is one less.
                    waiting.appendleft(cell)
                    refused = True
                    if not told:
                        board.warned(f"{cell.name} has to wait until another run has ended: {error}")
                    told = True
                    continue
                board.started(cell, running[-1].resumed)
            time.sleep(_POLL_SECONDS)
            for attempt, code in [(each, code) for each in running if (code := each.job.poll()) is not None]:
                running.remove(attempt)
                refused = False
                cell = attempt.cell
                if _must_start_again(attempt, code, folder):
                    _set_aside(run_folder(folder, cell))
                    board.warned(f"{cell.name} could not go on from its checkpoint; it starts again")
                    waiting.appendleft(cell)
                    continue
                state = _judge(attempt, code, folder, ledger.get(cell.name))
                if state.status == "failed" and code != _USER_ERROR and left[cell.name] > 0:
                    left[cell.name] -= 1
                    board.warned(f"{cell.name} failed: {state.error}; it is tried again, {left[cell.name]} tries left")
                    # At the end of the line: what made it fail may have passed by then.
                    ledger.set(cell.name, replace(state, status="pending"))
                    waiting.append(cell)
                    continue
                ledger.set(cell.name, state)
                board.ended(cell, state)
    finally:
        # Whatever ends this loop: no run goes on without a runner that would note its end.
        _stop(running)
        for attempt in running:
            state = replace(ledger.get(attempt.cell.name), status="interrupted", seconds=_age(attempt))
            ledger.set(attempt.cell.name, state)


def _start(cell: Cell, folder: Path, ledger: Ledger, command: Sequence[str], engine: Engine) -> Attempt:
    run_dir = run_folder(folder, cell)
    resumed = False
    if run_dir.exists():
        stopped = ended_as(run_dir) in (None, "stopped")
        resumed = not cell.timed and stopped and any((run_dir / "checkpoints").glob("*.safetensors"))
        if not resumed:
            _set_aside(run_dir)
    words = ("--resume", str(run_dir)) if resumed else (*cell.words, "--output", str(run_dir))
    state = ledger.get(cell.name)
    ledger.set(cell.name, CellState(status="running", attempts=state.attempts + 1))
    log = run_dir.with_name(f"{run_dir.name}.log")
    began = time.monotonic()
    try:
        job = engine.start(Order(name=cell.name, command=(*command, *words), log=log))
    except JobRefusedError:
        ledger.set(cell.name, state)
        raise
    return Attempt(cell=cell, job=job, log=log, began=began, resumed=resumed)


def _warm_up(matrix: Matrix, scene: str, folder: Path, board: Board, command: Sequence[str], engine: Engine) -> None:
    """Run the scene's warm-up and throw it away. Its failure is told and left to the runs to fail on."""
    words = matrix.warm_ups.get(scene)
    if words is None:
        return
    board.warming_up(scene)
    place = folder / "warm-up"
    shutil.rmtree(place, ignore_errors=True)
    log = folder / "warm-up.log"
    order = Order(name=f"warm-up {scene}", command=(*command, *words, "--output", str(place)), log=log)
    job = engine.start(order)
    try:
        while (code := job.poll()) is None:
            time.sleep(_POLL_SECONDS)
    except BaseException:
        job.kill()
        _wait([job], _GRACE_SECONDS)
        raise
    finally:
        shutil.rmtree(place, ignore_errors=True)
    if code != 0:
        board.warned(f"the warm-up of {scene} failed: {last_error(log)}")
    else:
        log.unlink(missing_ok=True)


def _must_start_again(attempt: Attempt, code: int, folder: Path) -> bool:
    """A run that was refused when it should go on, since its checkpoint is damaged or of another version. What else it
    is refused for, such as no GPU here or a full disk, may pass, and its checkpoint is then needed."""
    run_dir = run_folder(folder, attempt.cell)
    return attempt.resumed and code == _USER_ERROR and ended_as(run_dir) != "finished" and not _goes_on(run_dir)


def _goes_on(run_dir: Path) -> bool:
    """Whether its checkpoint can be read."""
    # Loads torch, which an experiment needs nowhere else.
    from sculpt_framework.engine.checkpoint import read_checkpoint

    try:
        read_checkpoint(run_dir / "checkpoints")
    except CheckpointError:
        return False
    return True


def _judge(attempt: Attempt, code: int, folder: Path, before: CellState) -> CellState:
    """The state of a cell whose process has ended."""
    ended = ended_as(run_folder(folder, attempt.cell))
    after = replace(before, seconds=_age(attempt), exit_code=code)
    if ended == "finished" and code == 0:
        return replace(after, status="finished", error=None)
    if ended == "stopped" and code == 0:
        return replace(after, status="interrupted", error="stopped from outside")
    if ended is None and code == 0:
        return replace(after, status="failed", error="it left no metrics.json; the observer recorder has to be there")
    if code < 0:
        return replace(after, status="failed", error=f"killed by {_signal_name(-code)}")
    return replace(after, status="failed", error=last_error(attempt.log))


def last_error(log: Path) -> str:
    """The last thing a run said about its failure: its error line, else the last line there is."""
    try:
        with open(log, "rb") as file:
            file.seek(max(0, log.stat().st_size - _LOG_TAIL))
            lines = [line.strip() for line in file.read().decode("utf-8", "replace").splitlines() if line.strip()]
    except OSError as error:
        return f"no log ({error.strerror})"
    said = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    return (said or lines or ["it said nothing"])[-1]


def _set_aside(run_dir: Path) -> None:
    """Rename what there is of a run, so that it can start again and nothing is lost."""
    number = 1
    while (target := run_dir.with_name(f"{run_dir.name}{ASIDE}{number}")).exists():
        number += 1
    run_dir.rename(target)


def _stop(running: Sequence[Attempt]) -> None:
    """End all processes; those that can go on later may save first. A second Ctrl-C ends them at once."""
    jobs = [attempt.job for attempt in running]
    for attempt in running:
        if attempt.cell.timed:
            attempt.job.kill()
        else:
            attempt.job.interrupt()
    try:
        ended = _wait(jobs, _GRACE_SECONDS)
    except KeyboardInterrupt:
        ended = False
    if not ended:
        for job in jobs:
            job.kill()
        _wait(jobs, _GRACE_SECONDS)


def _wait(jobs: Sequence[Job], seconds: float) -> bool:
    """Whether all of them end within so many seconds."""
    deadline = time.monotonic() + seconds
    while any(job.poll() is None for job in jobs):
        if time.monotonic() > deadline:
            return False
        time.sleep(_POLL_SECONDS)
    return True


def _age(attempt: Attempt) -> float:
    return round(time.monotonic() - attempt.began, 2)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _ends() -> list[signal.Signals]:
    """SIGTERM, and SIGHUP of a terminal that is closed. What was ignored before (nohup) stays so."""
    ends = (signal.SIGTERM, signal.SIGBREAK) if sys.platform == "win32" else (signal.SIGTERM, signal.SIGHUP)
    return [number for number in ends if signal.getsignal(number) is not signal.SIG_IGN]
