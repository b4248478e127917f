"""The plan as a short table on the console."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table
from rich.text import Text


def plan_table(values: Mapping[str, Any]) -> Table:
    """Of the data of the event "plan": what changes the run, a row each."""
    table = Table(title=f"scene plan, {values['seconds']:.1f} s", title_justify="left", pad_edge=False, box=None)
    for heading in ("item", "decided", "because", "saves", "override"):
        table.add_column(heading, overflow="fold")
    for row in values["decisions"]:
        cells = (row["item"], row["value"], row["evidence"], row["saves"] or "", row["override"])
        table.add_row(*(Text(str(cell)) for cell in cells))
    return table
