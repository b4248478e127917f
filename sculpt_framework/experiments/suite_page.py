"""The page of a suite: its tables, and the error of its runs over time."""

from collections.abc import Sequence

from sculpt_framework.comparison.diagrams import error_over_time
from sculpt_framework.comparison.pages import caveats
from sculpt_framework.comparison.runs import Measure, RunRecord
from sculpt_framework.evaluation.drawing import to_svg
from sculpt_framework.evaluation.web_page import bullets, grid_table, page
from sculpt_framework.experiments.results import CellResult, records
from sculpt_framework.experiments.suite_tables import notes, suite_tables
from sculpt_framework.experiments.suites import Suite


def suite_page(results: Sequence[CellResult], suite: Suite) -> str:
    """One page that loads nothing. The paper's figures have a table of their own."""
    ran = records(results)
    first, *others = suite_tables(results, suite)
    sections = [
        (first.title, grid_table(first.columns, first.rows)),
        ("Distance to the truth against time", curves(ran, "chamfer")),
        ("Held-out views against time", curves(ran, "psnr")),
        *((table.title, grid_table(table.columns, table.rows)) for table in others),
        ("Before comparing", bullets(caveats(ran))),
        ("How to read this", bullets(notes(suite))),
    ]
    return page(f"Suite {suite.name}", [(name, content) for name, content in sections if content])


def curves(shown: Sequence[RunRecord], measure: Measure) -> str:
    """A measure over wall seconds, of the scenes where a run has a curve of it; empty where none has."""
    scenes = {record.scene for record in shown if any(point.value(measure) is not None for point in record.curve)}
    drawing = error_over_time([record for record in shown if record.scene in scenes], measure, "wall")
    return f'<div style="max-width: {drawing.width:.0f}px">{to_svg(drawing)}</div>' if drawing else ""
