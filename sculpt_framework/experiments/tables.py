"""Tables of text: the same rows for a terminal and for Markdown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table as RichTable
from rich.text import Text

UNKNOWN = "–"
"""What is shown where nothing is known."""
FAILED = "failed"
_WIDEST = 400


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of text under headings; the first column names what a row is about."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """A heading of the third level and a table."""
        lines = [self.columns, ("---", *("---:" for _ in self.columns[1:])), *self.rows]
        return f"### {self.title}\n\n" + "".join(f"| {' | '.join(_escaped(line))} |\n" for line in lines)

    def show(self, console: Console) -> None:
        table = RichTable(title=self.title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
        for index, column in enumerate(self.columns):
            table.add_column(Text(column), justify="left" if index == 0 else "right", no_wrap=index == 0)
        for row in self.rows:
            # A failure's text may have brackets that rich takes for markup.
            table.add_row(*map(Text, row))
        # At its own width: a narrow terminal may break a line, but no figure is cut.
        width = console.width
        console.width = max(width, Measurement.get(console, console.options.update(max_width=_WIDEST), table).maximum)
        console.print(table, markup=False, highlight=False)
        console.width = width


def _escaped(cells: Sequence[str]) -> list[str]:
    return [cell.replace("|", "\\|") for cell in cells]


def power(unit: float) -> str:
    """A power of ten as people write it: 1e-2."""
    return f"1e{round(math.log10(unit))}"


def number(value: float | None, digits: int, *, times: float = 1.0) -> str:
    """A figure with so many digits behind the point; a dash where it is not known, a word for a failure."""
    if value is None or math.isnan(value):
        return UNKNOWN
    if math.isinf(value):
        return FAILED
    return f"{value * times:.{digits}f}"
