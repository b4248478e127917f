"""Runs of one method with several budgets, as the tables and pages of a suite name them."""

from collections.abc import Sequence
from dataclasses import replace

from sculpt_framework.experiments.matrix import Cell
from sculpt_framework.experiments.results import CellResult


def told_apart(results: Sequence[CellResult]) -> list[CellResult]:
    """The same; where there is more than one budget, each setting's name ends in that of its budget."""
    if len({result.cell.budget for result in results}) < 2:
        return list(results)
    return [_named(result) for result in results]


def _named(result: CellResult) -> CellResult:
    name = f"{result.cell.setting}, {_phrase(result.cell)}"
    record = None if result.record is None else replace(result.record, method=name)
    return replace(result, cell=replace(result.cell, setting=name), record=record)


def _phrase(cell: Cell) -> str:
    return cell.budget.phrase if cell.budget else "its own length"
