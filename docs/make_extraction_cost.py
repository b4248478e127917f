"""The table and the picture of docs/background/multi-resolution.md: ``python docs/make_extraction_cost.py FILE``.

FILE is what ``sculpt-bench extract --json`` has written.
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

PAGE = Path(__file__).parent / "background" / "multi-resolution.md"
PICTURE = Path(__file__).parent / "pictures" / "extraction-cost.png"

Row = Mapping[str, Any]


def table(rows: Sequence[Row], exponents: Sequence[Row]) -> str:
    """A line for each way and resolution, and the fitted powers."""
    lines = [
        "| way | cells | leaves with surface | faces | extraction, ms | step, ms | step, CPU ms | memory, MB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        counts = f"{row['resolution']} | {row['cells']} | {row['faces']}"
        costs = f"{row['extract_ms']:.0f} | {row['step_ms']:.0f} | {row['cpu_ms']:.0f} | {row['step_mb']:.0f}"
        lines.append(f"| {row['way']} | {counts} | {costs} |")
    for fit in exponents:
        powers = " | ".join(f"*{fit[name]:.2f}*" for name in ("extract_ms", "step_ms", "cpu_ms", "step_mb"))
        lines.append(f"| *{fit['way']}: power* | | | | {powers} |")
    return "\n".join(lines) + "\n"


def picture(rows: Sequence[Row]) -> Drawing:
    """CPU time and memory over the resolution, with what a square law would be."""
    ways = list(dict.fromkeys(row["way"] for row in rows))
    x = Axis(label="cells along the longest side", log=True)
    panels, colors = [], {}
    for title, name, label in (("Time", "cpu_ms", "CPU time, ms"), ("Memory", "step_mb", "memory, MB")):
        series = [
            Series(name=way, points=[(row["resolution"], row[name]) for row in rows if row["way"] == way])
            for way in ways
        ]
        first, last = min(row["resolution"] for row in rows), max(row["resolution"] for row in rows)
        least = min(row[name] for row in rows)
        square = [(first, least), (last, least * (last / first) ** 2)]
        series.append(Series(name="square of the resolution", points=square, style="member"))
        colors = series_colors(series)
        panels.append(line_drawing(title, series, x, Axis(label=label, log=True), colors=colors, legend=False))
    return sheet("An outer step without its renderings", panels, colors, columns=2)


def main() -> int:
    measured = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    text = table(measured["rows"], measured["exponents"])
    page = re.sub(
        r"(<!-- cost -->\n).*?(<!-- end -->)",
        lambda match: f"{match[1]}{text}{match[2]}",
        PAGE.read_text(encoding="utf-8"),
        flags=re.S,
    )
    write_atomically(PAGE, page.encode())
    write_atomically(PICTURE, to_png(picture(measured["rows"])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
