"""The pages of the site that the code itself writes: every command's help, every component with its options.

    python docs/make_reference.py

writes them into ``docs/reference/generated``; building the site does so first.
"""

import ast
import inspect
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import get_type_hints

from sculpt_framework import registry
from sculpt_framework.cli.sculpt import RARE, USUAL

FOLDER = Path(__file__).parent / "reference" / "generated"
WIDTH = 100


def main() -> int:
    FOLDER.mkdir(exist_ok=True)
    for name, text in (("commands.md", commands()), ("components.md", components())):
        path = FOLDER / name
        # A page that is as it was is not read again.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    return 0


def commands() -> str:
    """The help texts, as the parsers print them."""
    asked: list[tuple[str, str, list[str]]] = []
    for command in (*USUAL, *RARE):
        program = f"sculpt-{command.name}"
        asked.append((f"## {program}", command.module, []))
        if command.name == "train":
            asked.append((f"### {program} gaussian-sculpting", command.module, ["gaussian-sculpting"]))
        if command.name == "data":
            own = re.findall(r"^ {4}([a-z-]+)(?= |$)", help_of(command.module, []), re.MULTILINE)
            asked += [(f"### {program} {name}", command.module, [name]) for name in own]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        said = list(threads.map(lambda each: help_of(each[1], each[2]), asked))
    parts = [f"{heading}\n\n```text\n{text}\n```\n" for (heading, _, _), text in zip(asked, said, strict=True)]
    return "\n".join(["# Commands\n\nWhat `--help` prints.\n", *parts])


def help_of(module: str, words: list[str]) -> str:
    environment = {**os.environ, "COLUMNS": str(WIDTH), "TERM": "dumb", "NO_COLOR": "1"}
    command = [sys.executable, "-m", f"sculpt_framework.cli.{module}", *words, "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return done.stdout.strip()


def components() -> str:
    """Every component of every slot: what it says of itself, and its options with their defaults."""
    parts = [
        "# Components\n\nWhat each slot of the pipeline may be filled with. `--SLOT NAME` chooses one; its options are "
        "`--SLOT.OPTION VALUE`.\n"
    ]
    for slot in registry.SLOTS.values():
        parts.append(f"## {slot.name}\n")
        for name in registry.names(slot.name):
            kind = registry.load(slot.name, name)
            parts.append(f"### {name}\n\n{inspect.cleandoc(kind.__doc__ or '')}\n")
            rows = list(option_rows(kind))
            if rows:
                parts.append("\n".join(["| option | default | |", "|---|---|---|", *rows, ""]))
    return "\n".join(parts)


def option_rows(kind: type) -> Iterator[str]:
    said = field_docs(kind)
    hints = get_type_hints(kind)
    for each in fields(kind):
        if each.init:
            words = " ".join(said.get(each.name, "").split()).replace("|", "\\|")
            yield f"| `{each.name.replace('_', '-')}` | `{default_of(each, hints[each.name])}` | {words} |"


def default_of(each: Field, hint: object) -> str:
    if each.default is not MISSING:
        return str(each.default)
    return str(each.default_factory()) if each.default_factory is not MISSING else f"required: {hint}"


def field_docs(kind: type) -> dict[str, str]:
    """The strings under the fields of a dataclass and of those it is derived from."""
    out: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if base is object or base.__module__ == "builtins":
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        if not isinstance(body, ast.ClassDef):
            continue
        for before, after in zip(body.body, body.body[1:], strict=False):
            named = isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name)
            if named and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                out[before.target.id] = str(after.value.value)  # pyright: ignore[reportAttributeAccessIssue]
    return out


if __name__ == "__main__":
    sys.exit(main())
