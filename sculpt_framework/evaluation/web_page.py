"""Web pages that are one file: nothing is loaded from elsewhere."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from sculpt_framework.evaluation.charts import number

UNKNOWN = '<p class="unknown">Not recorded for this run.</p>'


def page(title: str, sections: Sequence[tuple[str, str]]) -> str:
    """A page of sections: a heading, which may be empty, and HTML; without any it says that nothing is recorded.

    Its policy forbids browsers to fetch anything.
    """
    body = "".join(
        f"<section>{f'<h2>{escape(name)}</h2>' if name else ''}{content or UNKNOWN}</section>"
        for name, content in sections
    )
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{_STYLE}</style></head>
<body><h1>{escape(title)}</h1>{body}</body></html>
"""


def facts_table(facts: Mapping[str, Any]) -> str:
    """A row per fact; empty of none."""
    rows = [
        f"<tr><th>{escape(str(name).replace('_', ' '))}</th><td>{escape(fact(value))}</td></tr>"
        for name, value in facts.items()
    ]
    return f"<table>{''.join(rows)}</table>" if rows else ""


def grid_table(head: Sequence[str], rows: Sequence[Sequence[str]], bold: Sequence[Sequence[bool]] = ()) -> str:
    """A table with a line of headings; empty without rows. ``bold``, if given, is per row and cell."""
    if not rows:
        return ""
    heading = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    lines = []
    for row, strong in zip(rows, bold or [[False] * len(head)] * len(rows), strict=True):
        cells = [f"<b>{escape(cell)}</b>" if mark else escape(cell) for cell, mark in zip(row, strong, strict=True)]
        lines.append(f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    return f"<table><tr>{heading}</tr>{''.join(lines)}</table>"


def bullets(items: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>" if items else ""


def details(summary: str, value: Any) -> str:
    """JSON to be unfolded."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(json.dumps(value, indent=2))}</pre></details>"


def fact(value: Any) -> str:
    """A value for people."""
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else str(value)


_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; max-width: 1440px; margin: 2rem auto;
       padding: 0 1.5rem; }
h1 { font-size: 1.6rem; margin-bottom: 1rem; }
h2 { font-size: 1.15rem; border-bottom: 1px solid #ddd; padding-bottom: .3rem; margin-top: 2.2rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .4rem; }
.tiles { display: flex; flex-wrap: wrap; gap: .8rem; }
.tiles div { border: 1px solid #ddd; border-radius: 8px; padding: .6rem 1rem; min-width: 7.5rem; }
.tiles b { display: block; font-size: 1.25rem; }
.tiles span, .unknown, figcaption { color: #666; font-size: .9rem; }
.charts, .pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(400px, 1fr)); gap: 1rem 2rem; }
.pictures { grid-template-columns: repeat(auto-fill, minmax(240px, 1fr)); }
.pictures img { width: 100%; border: 1px solid #ddd; }
figure { margin: 0; }
table { border-collapse: collapse; }
th, td { text-align: left; padding: .2rem 1.2rem .2rem 0; border-bottom: 1px solid #eee; font-weight: 400; }
th { color: #555; }
pre { background: #f6f6f6; padding: 1rem; overflow-x: auto; font-size: .85rem; }
"""
