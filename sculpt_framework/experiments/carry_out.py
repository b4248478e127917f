"""From a matrix to tables on disk and on the screen: what the commands that run experiments share."""

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from sculpt_framework.errors import TrainingFailed
from sculpt_framework.experiments.board import ConsoleBoard
from sculpt_framework.experiments.launching import Engine
from sculpt_framework.experiments.matrix import Cell, Matrix, require
from sculpt_framework.experiments.results import CellResult, read_results
from sculpt_framework.experiments.runner import run_matrix
from sculpt_framework.experiments.tables import Table
from sculpt_framework.export.atomic import write_atomically

Tables = Callable[[Sequence[CellResult]], tuple[list[Table], list[str], str]]
"""Of results: the tables, the notes below them, and the text of results.csv."""


def carry_out(
    matrix: Matrix,
    folder: Path,
    tables: Tables,
    *,
    asked: Sequence[str],
    jobs: int,
    retry_failed: bool,
    run: bool,
    measure: Callable[[Callable[[str], None]], None] = lambda told: None,
    page: Callable[[Sequence[CellResult]], str] | None = None,
    retries: int = 0,
    command: Sequence[str] | None = None,
    engine: Engine | None = None,
) -> tuple[CellResult, ...]:
    """Run what has not been run (nothing without ``run``), then write results.csv and tables.md and print the tables.

    ``asked`` is the command line this is done for; tables.md repeats it. Tables are written after an interrupt, too, of
    what there is. ``measure`` comes between runs and tables, but not without ``run``, and tells what it does; ``page``
    makes report.html. ``retries``, ``command`` and ``engine`` are as in ``run_matrix``. Returns the results. Raises
    SculptError as the runner does, and TrainingFailed if every run failed.
    """
    if not run:
        require(matrix, folder)
    console = Console()
    board = ConsoleBoard(console, lambda cell: _result_line(matrix, folder, cell), jobs)
    try:
        if run:
            run_matrix(
                matrix,
                folder,
                board,
                jobs=jobs,
                retry_failed=retry_failed,
                retries=retries,
                command=command,
                engine=engine,
            )
            measure(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True))
    except KeyboardInterrupt:
        board.close()
        console.print("interrupted; the same command goes on", markup=False, highlight=False)
        _write(folder, matrix, tables, page, asked)
        raise
    finally:
        board.close()
    results, made, notes = _write(folder, matrix, tables, page, asked)
    for table in made:
        table.show(console)
    for note in notes:
        console.print(note, markup=False, highlight=False, soft_wrap=True)
    names = ("tables.md", "results.csv", *(("report.html",) if page else ()))
    console.print(f"written: {', '.join(str(folder / name) for name in names)}", markup=False, highlight=False)
    ended = [result.record for result in results if result.record is not None]
    if run and ended and all(record.failed for record in ended):
        raise TrainingFailed(f"all {len(ended)} runs failed; the first said: {ended[0].reason}")
    return results


def _write(
    folder: Path,
    matrix: Matrix,
    tables: Tables,
    page: Callable[[Sequence[CellResult]], str] | None,
    asked: Sequence[str],
) -> tuple[tuple[CellResult, ...], list[Table], list[str]]:
    results = read_results(matrix, folder)
    made, notes, csv = tables(results)
    parts = [f"# {matrix.title}\n", f"    {shlex.join(asked)}\n", *(table.markdown() for table in made)]
    parts.append("".join(f"- {note}\n" for note in notes))
    write_atomically(folder / "results.csv", csv.encode())
    write_atomically(folder / "tables.md", "\n".join(parts).encode())
    if page is not None:
        write_atomically(folder / "report.html", page(results).encode())
    return results, made, notes


def _result_line(matrix: Matrix, folder: Path, cell: Cell) -> str:
    """The result of a run that has just finished."""
    one = Matrix(title=matrix.title, cells=(cell,), warm_ups={})
    (result,) = read_results(one, folder)
    if result.record is None:
        return "finished"
    chamfer, psnr = result.record.result("chamfer"), result.record.result("psnr")
    parts = [f"Chamfer {chamfer:.5f}" if chamfer is not None else "", f"{psnr:.2f} dB" if psnr is not None else ""]
    return ", ".join(part for part in parts if part) or "finished"
