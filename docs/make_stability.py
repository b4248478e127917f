"""The tables and the picture of docs/laboratory/stability.md: ``python docs/make_stability.py FILE ...``.

Each FILE is what ``sculpt-stress --json`` has written, of all groups or of some; a case in several files counts as in
the last one. Groups that no file has keep the table they have.
"""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sculpt_framework.evaluation.charts import Axis, Series, line_drawing, series_colors, sheet
from sculpt_framework.evaluation.drawing import Drawing
from sculpt_framework.evaluation.drawing_png import to_png
from sculpt_framework.export.atomic import write_atomically

PAGE = Path(__file__).parent / "laboratory" / "stability.md"
PICTURE = Path(__file__).parent / "pictures" / "safe-range.png"

Row = Mapping[str, Any]


def table(rows: Sequence[Row]) -> str:
    """A line for each case."""
    lines = [
        "| case | done | measured | limit | unit | float32 - float64 | |",
        "|---|---|---:|---:|---|---:|---|",
    ]
    for row in rows:
        sign = "≥" if row["at_least"] else "≤"
        measured = "–" if row["measured"] is None else f"{row['measured']:.2g}"
        limit = "–" if row["limit"] is None else f"{sign} {row['limit']:.2g}"
        error = "" if row["float32_error"] is None else f"{row['float32_error']:.1e}"
        told = " ".join(("" if row["ok"] else "**not within its limit**", row["note"].replace("|", "\\|"))).strip()
        name = f"`{row['id']}`"
        lines.append(f"| {name} | {row['done']} | {measured} | {limit} | {row['unit']} | {error} | {told} |")
    ok = sum(row["ok"] for row in rows)
    return f"{ok} of {len(rows)} cases within their limits.\n\n" + "\n".join(lines) + "\n"


def picture(rows: Sequence[Row]) -> Drawing:
    """Error over the factor on each weight and on each rate."""
    points = [row["curve"] for row in rows if row["curve"] is not None and row["curve"][2] is not None]
    names = list(dict.fromkeys(name for name, _, _ in points))
    panels, colors = [], {}
    for title, prefix, label in (
        ("Weights", "weight-", "factor on the weight"),
        ("Learning rates", "rate-", "factor on the rate"),
    ):
        series = [
            Series(name=name.removeprefix(prefix), points=[(x, y) for each, x, y in points if each == name])
            for name in names
            if name.startswith(prefix)
        ]
        if not series:
            continue
        colors |= series_colors(series)
        x, y = Axis(label=label, log=True), Axis(label="Chamfer distance, 1e-2", log=True)
        panels.append(line_drawing(title, series, x, y, colors=series_colors(series), legend=True))
    return sheet("Error of a small run over how stiff it is", panels, {}, columns=2)


def main() -> int:
    rows: dict[str, Row] = {}
    for path in sys.argv[1:]:
        rows |= {row["id"]: row for row in json.loads(Path(path).read_text(encoding="utf-8"))["cases"]}
    page = PAGE.read_text(encoding="utf-8")
    for group in dict.fromkeys(row["group"] for row in rows.values()):
        text = table([row for row in rows.values() if row["group"] == group])
        page = re.sub(rf"(<!-- {group} -->\n).*?(<!-- end -->)", lambda m, t=text: f"{m[1]}{t}{m[2]}", page, flags=re.S)
    write_atomically(PAGE, page.encode())
    if any(row["curve"] is not None for row in rows.values()):
        write_atomically(PICTURE, to_png(picture(list(rows.values()))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
