"""``sculpt``: what commands there are, and each of them by its last word."""

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from sculpt_framework import registry
from sculpt_framework.cli import exit_codes
from sculpt_framework.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Command:
    """One of the commands. Each is a program of its own, too: ``sculpt-`` and its name."""

    name: str
    module: str
    said: str
    """What it does, in a line."""


USUAL = (
    Command(name="train", module="train", said="reconstruct: photographs in, a watertight mesh out"),
    Command(name="data", module="data", said="look at photographs before a run; pose, mask and scale them"),
    Command(name="view", module="view", said="a run in the browser"),
    Command(name="eval", module="evaluate", said="how good a mesh is"),
    Command(name="export", module="export", said="a result in the format another program wants"),
    Command(name="report", module="report", said="runs beside each other"),
    Command(name="batch", module="batch", said="every scene of a folder or a list"),
)
RARE = (
    Command(name="bench", module="bench", said="the speed of the parts; suites of whole runs"),
    Command(name="ablate", module="ablate", said="what each part of a method is worth"),
    Command(name="stress", module="stress", said="stiff and extreme cases, with a figure each"),
)
HELP = ("-h", "--help")


def main() -> None:
    """The console script ``sculpt``."""
    exit_codes.run(lambda: sculpt(sys.argv[1:]))


def sculpt(words: Sequence[str]) -> None:
    """Run a command, or list them. Raises ConfigError for one that there is not."""
    if not words or words[0] in HELP:
        sys.stdout.write(listed())
        return
    found = {command.name: command for command in (*USUAL, *RARE)}.get(words[0])
    if found is None:
        near = registry.closest(words[0], [each.name for each in (*USUAL, *RARE)])
        hint = f"did you mean {near}? " if near else ""
        raise ConfigError(f"{words[0]}: there is no such command; {hint}sculpt --help lists them.")
    sys.argv = [f"sculpt-{found.name}", *words[1:]]
    importlib.import_module(f"sculpt_framework.cli.{found.module}").main()


def listed() -> str:
    """The help text."""
    lines = ["usage: sculpt COMMAND ...", "", "Posed photographs of one object in, a watertight mesh out.", ""]
    lines += [f"  {command.name:<8} {command.said}" for command in USUAL]
    lines += ["", "for measuring the program itself:"]
    lines += [f"  {command.name:<8} {command.said}" for command in RARE]
    lines += [
        "",
        "sculpt COMMAND --help says more of each. sculpt-train, sculpt-data and so on are the same commands.",
        "The first run: sculpt train gaussian-sculpting --data demo",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
