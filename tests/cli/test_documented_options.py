"""The options that the documents name are there: those of their commands, and those of their sentences."""

import importlib
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.cli.bench import COMMANDS
from sculpt_framework.cli.sculpt import RARE, USUAL
from sculpt_framework.command_line.options import flags, swap_components
from sculpt_framework.config import MethodConfig

ROOT = Path(__file__).parents[2]
OWN_TESTS = ("writing-a-plugin.md", "writing-a-method.md")
"""Pages whose packages are installed where their commands are tested."""
PAGES = [page for page in (ROOT / "README.md", *ROOT.glob("docs/**/*.md")) if page.name not in OWN_TESTS]
MODULES = {f"sculpt-{each.name}": f"sculpt_framework.cli.{each.module}" for each in (*USUAL, *RARE)}
COMMANDS_OF = {
    "sculpt-data": ("demo", "list", "inspect", "box", "masks", "depths", "pose", "markers", "scale", "pose-board"),
    "sculpt-bench": tuple(COMMANDS),
}
COMMAND = re.compile(r"(?:^\s*(?:\$ )?|`)(sculpt-[a-z]+)\b(?![^\n]*\n\s*error:)(.*?)(?=[`#|>\n]| {4})", re.MULTILINE)
"""At the start of a line or in backticks, up to what is said about it, unless it is there to show an error."""
PLACEHOLDER = re.compile(r"[\[\]]|\.\.\.|--[a-z]+ (?:NAME|FORMAT|\$\w+)")
"""Brackets around what may be left out, dots for more of the same, a component or a format that is any."""
ELSEWHERE = {"--every", "--full", "--keep-raw", "--kernels", "--start"}
"""Options of programs beside the documents."""


def commands(program: str) -> Iterator[list[str]]:
    """The words after the program's name in its commands. What others hand on to ``sculpt-train`` is its own."""
    for page in PAGES:
        for name, text in COMMAND.findall(re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8"))):
            own, _, handed_on = PLACEHOLDER.sub(" ", text).partition(" -- ")
            if name == program:
                yield own.split()
            if program == "sculpt-train" and handed_on:
                yield handed_on.split()


def options(text: str) -> set[str]:
    return set(re.findall(r"(?<![\w-])--[a-z][a-z0-9.-]*[a-z0-9]", text))


def options_of_training(config: MethodConfig) -> set[str]:
    return {f"--{name}" for name in (*flags(config), "help", "help-all")}


def switched_on(option: str) -> str:
    return option.replace(".no-", ".")


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., set[str]]:
    """``offered(program, *words)``: the options in the help that the program gives after these words."""

    def ask(program: str, *words: str) -> set[str]:
        monkeypatch.setattr(sys, "argv", [program, *words, "--help"])
        with pytest.raises(SystemExit) as ended:
            importlib.import_module(MODULES[program]).main()
        assert ended.value.code == 0
        return options(capsys.readouterr().out)

    return ask


def test_commands_of_training():
    seen = set()
    for words in commands("sculpt-train"):
        method = words[0] if words and words[0] in registry.method_names() else "gaussian-sculpting"
        known = options_of_training(swap_components(registry.load_method(method)(), words)[0])
        named = options(" ".join(words))
        assert {option for option in named if switched_on(option) not in known} <= known, words
        seen |= named
    assert len(seen) > 30


@pytest.mark.parametrize("program", [name for name in MODULES if name not in ("sculpt-train", "sculpt-export")])
def test_commands_of_other_programs(program: str, offered: Callable[..., set[str]]):
    named: dict[tuple[str, ...], set[str]] = {}
    for words in commands(program):
        command = tuple(word for word in words[:1] if word in COMMANDS_OF.get(program, ()))
        named.setdefault(command, set()).update(options(" ".join(words)))
    assert named
    for command, wanted in named.items():
        assert wanted <= offered(program, *command), command


def test_commands_that_export(offered: Callable[..., set[str]]):
    known = {name: offered("sculpt-export", "--format", name) for name in registry.export_formats()}
    for words in commands("sculpt-export"):
        name = words[words.index("--format") + 1] if "--format" in words else None
        assert options(" ".join(words)) <= (known[name] if name else set().union(*known.values())), words


def test_sentences(offered: Callable[..., set[str]]):
    """An option in backticks is one of some program, method, component or format."""
    default = registry.load_method("gaussian-sculpting")()
    configs = [registry.load_method(name)() for name in registry.method_names()]
    for slot in registry.SLOTS:
        configs += [swap_components(default, (f"--{slot}", name))[0] for name in registry.names(slot)]
    known = ELSEWHERE.union(*map(options_of_training, configs))
    for name in registry.export_formats():
        known |= offered("sculpt-export", "--format", name)
    for program in (name for name in MODULES if name not in ("sculpt-train", "sculpt-export")):
        known = known.union(*(offered(program, command) for command in COMMANDS_OF.get(program, ())))
        known |= offered(program)
    for page in PAGES:
        named = set(re.findall(r"`(--[a-z0-9.-]*[a-z0-9])(?![a-z0-9.-])", page.read_text(encoding="utf-8")))
        assert {option for option in named if switched_on(option) not in known} == set(), page
