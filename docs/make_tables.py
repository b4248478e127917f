"""Fill in the tables of docs/background/choices.md from the code: ``python docs/make_tables.py``; ``--check`` compares.

Two kinds of table. Rows that begin with an option (`` | `binder.scale` | ``) get the option's value in both methods.
What is between ``<!-- NAME -->`` and ``<!-- end -->`` is written whole. Reasons stay as people wrote them.
"""

import inspect
import re
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import cast

from sculpt_framework.config import ComponentConfig
from sculpt_framework.registry import SLOTS, name_of
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_methods.paper import gaussian_sculpting_paper
from sculpt_methods.sculpting import gaussian_sculpting

PAGE = Path(__file__).parent / "background" / "choices.md"
ABSENT = "–"
_ROW = re.compile(r"^\| `([a-z0-9_.-]+)` \|[^|]*\|[^|]*\| (.*)\|$", re.MULTILINE)
_NAMED_VALUE = re.compile(r"^\s*(?:(\w+)=)?(.*?),?\s*# (.*)$")


def filled(page: str) -> str:
    """The page with every value as the code has it. Raises KeyError for an option that no longer exists."""
    paper, default = gaussian_sculpting_paper(), gaussian_sculpting()

    def row(match: re.Match[str]) -> str:
        path = match[1]
        values = [value_of(config, path) for config in (paper, default)]
        if values == [ABSENT, ABSENT]:
            raise KeyError(f"{PAGE.name}: neither method has an option {path}")
        return f"| `{path}` | {values[0]} | {values[1]} | {match[2]}|"

    page = _ROW.sub(row, page)
    parts = {"paper": paper_table(), "stages": stages_table(paper, default)}
    for name, text in parts.items():
        page = re.sub(rf"(<!-- {name} -->\n).*?(<!-- end -->)", lambda m, t=text: f"{m[1]}{t}{m[2]}", page, flags=re.S)
    return page


def value_of(config: SculptingConfig, path: str) -> str:
    """The value at ``slot.option`` (``slot.component.option`` in slots of many); a slot alone names its component."""
    slot, *rest = path.split(".")
    if slot not in {field.name for field in fields(config)}:
        return ABSENT
    found: object = getattr(config, slot)
    if slot in SLOTS and SLOTS[slot].many:
        found = next((part for part in getattr(config, slot) if name_of(part) == rest[0]), None)
        rest = rest[1:]
    elif slot in SLOTS and not rest:
        return name_of(cast(ComponentConfig, found))
    for name in rest:
        if not is_dataclass(found) or name not in {field.name for field in fields(found)}:
            return ABSENT
        found = getattr(found, name)
    if isinstance(found, bool):
        return "yes" if found else "no"
    return f"{found:g}" if isinstance(found, float) else str(found)


def paper_table() -> str:
    """One row per commented value of the paper's method."""
    rows, part = [], ""
    for line in inspect.getsource(gaussian_sculpting_paper).splitlines():
        opened = re.match(r"\s*(\w+)=\w+Config\(\s*$", line)
        if opened:
            part = opened[1]
        found = _NAMED_VALUE.match(line)
        if not found or not found[2]:
            continue
        indent = len(line) - len(line.lstrip())
        name = found[1] or ""
        label = f"{part}.{name}" if indent > 8 and name else name
        shown = f"`{label} = {found[2]}`" if label else f"`{found[2]}`"
        rows.append(f"| {shown} | {found[3]} |")
    return "| value | where it comes from |\n|---|---|\n" + "\n".join(rows) + "\n"


def stages_table(paper: SculptingConfig, default: SculptingConfig) -> str:
    rows = ["| method | share of steps | grid | images | inner steps | outer views |", "|---|---|---|---|---|---|"]
    for config in (paper, default):
        for stage in config.trainer.stages:
            grid, inner = config.trainer.base_cells << stage.level, stage.inner_steps
            views = f"{stage.outer_views}{', silhouettes only' if stage.silhouette_only else ''}"
            scale = f"{100 * stage.image_scale:g} %"
            rows.append(f"| {config.method} | {100 * stage.share:g} % | {grid} | {scale} | {inner} | {views} |")
    return "\n".join(rows) + "\n"


def main() -> int:
    page = PAGE.read_text(encoding="utf-8")
    new = filled(page)
    if "--check" in sys.argv[1:]:
        if new != page:
            sys.stderr.write("docs/background/choices.md is not what the code says; run python docs/make_tables.py\n")
        return int(new != page)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
