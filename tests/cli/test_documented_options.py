"""The options that sentences of the documents name are there. Blocks of commands: tests/test_document_commands.py."""

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.cli.bench import COMMANDS
from sculpt_framework.cli.sculpt import RARE, USUAL
from sculpt_framework.command_line.options import flags, swap_components

ROOT = Path(__file__).parents[2]
OWN_PACKAGES = ("writing-a-plugin.md", "writing-a-method.md")
"""Pages with options of packages that they write."""
PAGES = [
    page
    for page in (ROOT / "README.md", *ROOT.glob("docs/**/*.md"))
    if page.name not in OWN_PACKAGES and "generated" not in page.relative_to(ROOT).parts
]
MODULES = {f"sculpt-{each.name}": f"sculpt_framework.cli.{each.module}" for each in (*USUAL, *RARE)}
COMMANDS_OF = {
    "sculpt-data": ("demo", "list", "inspect", "box", "masks", "depths", "pose", "markers", "scale", "pose-board"),
    "sculpt-bench": tuple(COMMANDS),
}
ELSEWHERE = {"--every", "--full", "--keep-raw", "--kernels", "--start"}
"""Options of programs beside the documents."""


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., set[str]]:
    """``offered(program, *words)``: the options in the help that the program gives after these words."""

    def ask(program: str, *words: str) -> set[str]:
        monkeypatch.setattr(sys, "argv", [program, *words, "--help"])
        with pytest.raises(SystemExit) as ended:
            importlib.import_module(MODULES[program]).main()
        assert ended.value.code == 0
        return set(re.findall(r"(?<![\w-])--[a-z][a-z0-9.-]*", capsys.readouterr().out))

    return ask


def test_every_option_that_is_named_is_one_of_some_program_method_component_or_format(
    offered: Callable[..., set[str]],
):
    default = registry.load_method("gaussian-sculpting")()
    configs = [registry.load_method(name)() for name in registry.method_names()]
    for slot in registry.SLOTS:
        configs += [swap_components(default, (f"--{slot}", name))[0] for name in registry.names(slot)]
    known = ELSEWHERE | {"--help", "--help-all"} | {f"--{flag}" for config in configs for flag in flags(config)}
    for name in registry.export_formats():
        known |= offered("sculpt-export", "--format", name)
    for program in (name for name in MODULES if name not in ("sculpt-train", "sculpt-export")):
        known = known.union(*(offered(program, command) for command in COMMANDS_OF.get(program, ())))
        known |= offered(program)
    seen = set()
    for page in PAGES:
        named = set(re.findall(r"`(--[a-z0-9.-]*[a-z0-9])(?![a-z0-9.-])", page.read_text(encoding="utf-8")))
        assert {option for option in named if option.replace(".no-", ".") not in known} == set(), page
        seen |= named
    assert len(seen) > 100
