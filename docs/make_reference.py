"""The pages of the site that the code itself writes: every command's help, every method and component with its options.

    python docs/make_reference.py

writes them into ``docs/reference/generated``; building the site does so first.
"""

import ast
import functools
import inspect
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any, cast, get_type_hints

from sculpt_framework import registry
from sculpt_framework.cli.bench import COMMANDS as BENCH_COMMANDS
from sculpt_framework.cli.sculpt import RARE, USUAL
from sculpt_framework.command_line.options import HIDDEN
from sculpt_framework.config import ComponentConfig, MethodConfig
from sculpt_framework.sculpting.config import PlanConfig

FOLDER = Path(__file__).parent / "reference" / "generated"
WIDTH = 100


def main() -> int:
    FOLDER.mkdir(exist_ok=True)
    for name, text in (("commands.md", commands()), ("methods.md", methods()), ("components.md", components())):
        path = FOLDER / name
        # A page that is as it was is not read again.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    return 0


def commands() -> str:
    """The help texts, as the parsers print them."""
    asked = list(all_words())
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        said = list(threads.map(help_of, asked))
    parts = [
        f"{'##' if len(words) < 2 else '###'} {program(words)}\n\n```text\n{text}\n```\n"
        for words, text in zip(asked, said, strict=True)
    ]
    return "\n".join(["# Commands\n\nWhat `--help` prints. Options of methods: [methods](methods.md).\n", *parts])


def program(words: tuple[str, ...]) -> str:
    """The command as it is typed: ``sculpt``, or ``sculpt-`` and its name, and what follows."""
    return " ".join(("-".join(("sculpt", *words[:1])), *words[1:]))


def all_words() -> Iterator[tuple[str, ...]]:
    """The words after ``sculpt`` whose help is shown: none, each command, and those that follow a command."""
    yield ()
    for command in (*USUAL, *RARE):
        yield (command.name,)
        if command.name == "train":
            yield (command.name, "gaussian-sculpting")
        if command.name == "data":
            own = re.findall(r"^ {4}([a-z-]+)(?= |$)", help_of((command.name,)), re.MULTILINE)
            yield from ((command.name, name) for name in own)
        if command.name == "export":
            yield from ((command.name, "--format", name) for name in registry.export_formats())
        if command.name == "bench":
            yield from ((command.name, name) for name in BENCH_COMMANDS)


def help_of(words: tuple[str, ...]) -> str:
    environment = {**os.environ, "COLUMNS": str(WIDTH), "TERM": "dumb", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "sculpt_framework.cli.sculpt", *words, "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, encoding="utf-8")
    return done.stdout.strip()


def methods() -> str:
    """Every method: what it says of itself, the component in each slot, and its options with their defaults."""
    said = field_docs(MethodConfig)
    general = [
        row(each.name, default_of(each, ""), said.get(each.name, ""))
        for each in fields(MethodConfig)
        if each.name not in (*HIDDEN, *registry.SLOTS)
    ]
    parts = [
        "# Methods\n\nThe first word after `sculpt-train`. An option is given as `--OPTION VALUE`; where its default "
        "is True or False, as `--OPTION` or `--no-OPTION`, within a group `--GROUP.no-OPTION`. The options of "
        "components are in [components](components.md).\n",
        "## Options of every method\n",
        table(("option", "default", ""), [*general, *WORDS]),
    ]
    first_of: dict[type[MethodConfig], str] = {}
    for name in registry.method_names():
        make = registry.load_method(name)
        config, kind = make(), type(make())
        parts.append(f"## {name}\n\n{inspect.cleandoc(make.__doc__ or '')}\n")
        if kind in first_of:
            like = registry.load_method(first_of[kind])()
            parts.append(f"Its options are those of [{first_of[kind]}](#{first_of[kind]}).\n")
            parts.append(table(("slot", "component", "set otherwise than the component's default"), slot_rows(config)))
            changed = list(changed_rows(config, like))
            parts.append(table(("option", "default", f"of {first_of[kind]}", ""), changed))
            continue
        first_of[kind] = name
        parts.append(f"{inspect.cleandoc(kind.__doc__ or '')}\n")
        parts.append(table(("slot", "component", "set otherwise than the component's default"), slot_rows(config)))
        for name_and_words, rows in groups(config):
            parts += [name_and_words, table(("option", "default", ""), rows)]
    return "\n".join(parts)


WORDS = (
    "| `config` | | Settings from a file in JSON: a run's config.json, or a part of one. |",
    "| `resume` | | In place of a method: go on with the run saved in this folder. |",
    "| `viewer` | | Watch in the browser: adds the observer `viser`. |",
    "| `SLOT` | | The component in this slot, by name; where there may be several, their names, or `none`. |",
)
"""Options of every method that are no fields of its config."""


def slot_rows(config: MethodConfig) -> Iterator[str]:
    """Which component the method puts into each of its slots."""
    for slot in registry.slots_of(type(config)).values():
        value = getattr(config, slot.name)
        for index, part in enumerate(value if isinstance(value, tuple) else (value,)):
            name = registry.name_of(cast(ComponentConfig, part))
            usual = dict(options_of(registry.default(slot.name, name)))
            own = [f"`{option} {text}`" for option, text in options_of(part) if usual.get(option) != text]
            link = f"[{name}](components.md#{slot.name}-{name})"
            yield f"| {slot.name if index == 0 else ''} | {link} | {', '.join(own)} |"


def groups(config: MethodConfig) -> Iterator[tuple[str, list[str]]]:
    """The rows of the method's own options: first of those that are alone, then of each group. Above them stands what
    they are."""
    said = field_docs(type(config))
    own = [name for name in own_fields(config) if not is_dataclass(getattr(config, name))]
    yield "Options:\n", [row(name, shown(getattr(config, name)), said.get(name, "")) for name in own]
    for name in own_fields(config):
        group = getattr(config, name)
        if is_dataclass(group):
            yield (
                f"`{name.replace('_', '-')}`: {inspect.cleandoc(group.__doc__ or '')}\n",
                [row(option, text, words) for option, text, words in described(group, f"{name}.")],
            )


def own_fields(config: MethodConfig) -> Iterator[str]:
    """Names of the method's fields that are options, but of those that every run has only what it sets otherwise."""
    general = {each.name: each.default for each in fields(MethodConfig)}
    for each in fields(config):
        usual = general.get(each.name, MISSING)
        if each.name not in (*HIDDEN, *registry.SLOTS) and getattr(config, each.name) != usual:
            yield each.name


def changed_rows(config: MethodConfig, like: MethodConfig) -> Iterator[str]:
    """Rows of the options whose value differs from that in ``like``, a config of the same type."""
    usual = {option: text for option, text, _ in described(like)}
    for option, text, words in described(config):
        if option.partition(".")[0] not in registry.SLOTS and usual.get(option) != text:
            yield row(option, text, usual.get(option, ""), words)


def described(config: Any, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Option, value and description of every field; fields of a group and items of a list have a dot before them."""
    said = field_docs(type(config))
    for each in fields(config):
        value = getattr(config, each.name)
        if each.name in HIDDEN and isinstance(config, MethodConfig):
            continue
        if isinstance(config, PlanConfig) and each.name == "mode":
            yield prefix.removesuffix("."), shown(value), said[each.name]
        elif is_dataclass(value):
            yield from described(value, f"{prefix}{each.name}.")
        elif isinstance(value, tuple) and any(is_dataclass(item) for item in value):
            for index, item in enumerate(value):
                yield from described(item, f"{prefix}{each.name}.{index}.")
        else:
            yield f"{prefix}{each.name}", shown(value), said.get(each.name, "")


def options_of(config: Any) -> Iterator[tuple[str, str]]:
    return ((option.replace("_", "-"), text) for option, text, _ in described(config))


def shown(value: object) -> str:
    """A value as it is written on the command line."""
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def table(heads: tuple[str, ...], rows: Iterator[str] | list[str]) -> str:
    return "\n".join([f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}", *rows, ""])


def row(option: str, *cells: str) -> str:
    """An option, its values, and what is said of it."""
    *values, said = (" ".join(cell.split()).replace("|", "\\|") for cell in cells)
    return f"| {' | '.join((code(option.replace('_', '-')), *map(code, values), said))} |"


def code(text: str) -> str:
    return f"`{text}`" if text else ""


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
            # Several slots have a component of the same name: headings alone are no places to link to.
            parts.append(f"({slot.name}-{name})=\n### {name}\n\n{inspect.cleandoc(kind.__doc__ or '')}\n")
            rows = list(option_rows(kind))
            if rows:
                parts.append(table(("option", "default", ""), rows))
    return "\n".join(parts)


def option_rows(kind: type) -> Iterator[str]:
    said = field_docs(kind)
    hints = get_type_hints(kind)
    for each in fields(kind):
        if each.init:
            yield row(each.name, default_of(each, f"required: {hints[each.name]}"), said.get(each.name, ""))


def default_of(each: Field, without: str) -> str:
    """Its default, or ``without`` where there is none."""
    if each.default is not MISSING:
        return shown(each.default)
    return shown(each.default_factory()) if each.default_factory is not MISSING else without


@functools.cache
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
