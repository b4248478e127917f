"""What the documents' blocks of code say is there: commands with their options, and what Python code imports."""

import argparse
import ast
import importlib
import re
import shlex
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import tyro

from sculpt_framework import registry
from sculpt_framework.cli.ablate import split_extra
from sculpt_framework.cli.sculpt import RARE, USUAL, sculpt

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    page for page in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")) if "generated" not in page.relative_to(ROOT).parts
)
DEFAULT = "gaussian-sculpting"
PROGRAMS = {command.name: f"sculpt_framework.cli.{command.module}" for command in (*USUAL, *RARE)}
COMMAND = re.compile(
    r"(?:\$ )?((?:sculpt(?:-[a-z]+)?|torchrun|python (?:docs|examples|tests|plugins)/\S+) .*|sculpt-[a-z]+$)"
)


class Parsed(BaseException):
    """The words are understood: this takes the place of what would be done with them."""


# -- commands --------------------------------------------------------------------------------------------------------


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """The page's blocks of code, each with its language; of those that are indented it is "indented"."""
    text = page.read_text(encoding="utf-8")
    fence = re.compile(r"^( *)```([\w{}-]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
    for found in fence.finditer(text):
        yield found[2], found[3]
    for block in re.findall(r"(?:\A|\n)\n((?: {4}.*\n)+)", fence.sub("", text) + "\n"):
        yield "indented", block


def commands_of(page: Path) -> list[tuple[str, str]]:
    """The commands of this project in the page's blocks, as a shell would split them: no pipes, no comments. With each
    the message about its mistake, if the page shows one below."""
    found: list[tuple[str, str]] = []
    for language, block in blocks(page):
        if language not in ("", "sh", "console", "indented") or re.search(r"-->|<--", block):  # Diagrams have arrows.
            continue
        lines = re.sub(r"\\\n\s*", " ", block).splitlines()
        for line, below in zip(lines, [*lines[1:], ""], strict=True):
            error = below.strip() if below.strip().startswith("error: ") else ""
            parts = re.split(r"&&|;|\|(?=\s)|(?<=\s)>", re.sub(r"(^|\s)#.*", "", line))
            found += [(match[1], error) for part in parts if (match := COMMAND.fullmatch(part.strip()))]
    return found


def words_of(command: str) -> list[str]:
    """The command's words. What may be left out, in brackets, is there if it is an option; ``...`` is nothing; a name
    in capitals stands for a number: 1, or that of a coordinate. What a variable of the shell holds is not known."""
    command = re.sub(r"\[(?!:)([^\]]*)\]", lambda match: match[1] if match[1].startswith("-") else "", command)
    command = re.sub(r"\$\{[^}]*\}|\$\w+", "$", command)
    command = re.sub(r"--\S+ \$(?=\s|$)", "", command)
    words = [re.sub(r"\.\.\.$", "", word) for word in shlex.split(command)]
    return [re.sub(r"^(?:[XYZ]([01])|[A-Z][A-Z_]*)$", lambda match: match[1] or "1", word) for word in words if word]


def written_in(page: Path) -> dict[str, str]:
    """What a package that the page writes registers, and its name: other tests install it and run its commands."""
    text = "".join(block for language, block in blocks(page) if language == "toml")
    return dict(re.findall(r"^([\w-]+) = \"(\w+)[\w.]*:\w+\"$", text, re.MULTILINE))


def of_training(words: Sequence[str]) -> list[str]:
    """The words as those of a new run, without files that are read: what they say is not the documents' affair."""
    rest = list(words)
    for option in ("--resume", "--config"):
        if option in rest:
            del rest[rest.index(option) : rest.index(option) + 2]
    for slot in registry.SLOTS:
        if f"--{slot}" in rest and rest[rest.index(f"--{slot}") + 1] == "1":
            del rest[rest.index(f"--{slot}") : rest.index(f"--{slot}") + 2]
    if not rest or rest[0].startswith("-"):
        rest = [DEFAULT, *rest]
    if rest[0] == "1":
        rest[0] = DEFAULT
    return rest if "--data" in rest else [*rest, "--data", "1"]


def methods_in(words: Sequence[str]) -> list[str]:
    return [word for word in words if word in registry.method_names()] or [DEFAULT]


def check_program(path: Path, words: Sequence[str]) -> None:
    """A program of the repository: it is there, and names each of these options."""
    assert path.is_file()
    source = path.read_text(encoding="utf-8")
    arguments = {
        argument.arg
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef) and node.name == "main"
        for argument in (*node.args.args, *node.args.kwonlyargs)
    }
    for word in words:
        option = word.partition("=")[0]
        if option.startswith("--"):
            named = re.search(rf"[\"'\[]{option}[\"'\]]", source)
            assert named or option.removeprefix("--").replace("-", "_") in arguments, f"{path.name} has no {option}"


@pytest.fixture
def understood(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """A function that asserts that a command understands these words, or says this about them, and does no more."""
    tyro_cli, parse_args = tyro.cli, argparse.ArgumentParser.parse_args

    def cli(*places: Any, **named: Any) -> Any:
        result = tyro_cli(*places, **named)
        if named.get("return_unknown_args") and result[1]:
            return result
        raise Parsed

    def parsed(parser: argparse.ArgumentParser, *places: Any, **named: Any) -> None:
        parse_args(parser, *places, **named)
        raise Parsed

    monkeypatch.setattr(tyro, "cli", cli)
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parsed)
    monkeypatch.setattr(sys, "argv", sys.argv)

    def check(name: str, words: Sequence[str], error: str = "") -> None:
        said = ""
        try:
            sculpt([name, *words])
        except Parsed:
            pass
        except SystemExit as end:
            said = capsys.readouterr().err.strip() if end.code else ""
        assert said == error, " ".join((f"sculpt-{name}", *words))

    return check


@pytest.mark.parametrize("page", [page for page in PAGES if commands_of(page)], ids=lambda page: page.stem)
def test_commands_are_understood(page: Path, understood):
    elsewhere = written_in(page)
    for command, error in commands_of(page):
        program, *words = words_of(command)
        if elsewhere.keys() & set(words):
            continue
        if program == "torchrun":
            place = words.index("-m")
            program, words = f"sculpt-{words[place + 1].rpartition('.')[2]}", words[place + 2 :]
        own, extra = split_extra(words)
        if program == "python":
            check_program(ROOT / own[0], own[1:])
        else:
            name = program.removeprefix("sculpt-") if program != "sculpt" else own.pop(0)
            assert name in PROGRAMS, command
            own = of_training(own) if name == "train" else own
            understood(name, own, error)
        if extra:
            understood("train", of_training([methods_in(own)[0], *extra]))


# -- Python ----------------------------------------------------------------------------------------------------------


def python_of(page: Path) -> list[str]:
    return [block for language, block in blocks(page) if language == "python"]


@pytest.mark.parametrize("page", [page for page in PAGES if python_of(page)], ids=lambda page: page.stem)
def test_python_can_be_read_and_imports_what_there_is(page: Path):
    elsewhere = set(written_in(page).values())
    for node in (node for block in python_of(page) for node in ast.walk(ast.parse(textwrap.dedent(block)))):
        if isinstance(node, ast.Import):
            for name in node.names:
                importlib.import_module(name.name)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] not in elsewhere:
            module = importlib.import_module(node.module)
            for name in node.names:
                if not hasattr(module, name.name):
                    importlib.import_module(f"{node.module}.{name.name}")
