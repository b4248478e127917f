"""The pages of the site that ``docs/make_reference.py`` writes."""

import re

import pytest
from make_reference import HIDDEN, all_words, help_of, methods

from sculpt_framework import registry
from sculpt_framework.cli.bench import COMMANDS
from sculpt_framework.cli.sculpt import RARE, USUAL
from sculpt_framework.command_line.options import flags
from sculpt_framework.command_line.request import parse


def test_every_method_is_described_with_every_option_and_its_own_default():
    sections = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", methods(), re.MULTILINE | re.DOTALL))
    general = sections.pop("Options of every method")
    assert tuple(sections) == registry.method_names()
    for name, section in sections.items():
        config = parse([name, "--data", "demo"])
        # A method whose options are another's shows what differs.
        like = re.search(r"Its options are those of \[(.*?)\]", section)
        shown = section + (sections[like[1]] if like else "")
        listed = set(re.findall(r"^\| `(.*?)` \|", shown + general, re.MULTILINE))
        options = [option.replace("_", "-") for option in flags(config)]
        assert [each for each in options if each not in listed and each.partition(".")[0] not in registry.SLOTS] == []
        assert f"| `steps` | `{config.steps}` |" in section or like
        for slot in registry.slots_of(type(config)):
            value = getattr(config, slot)
            for part in value if isinstance(value, tuple) else (value,):
                assert f"components.md#{slot}-{registry.name_of(part)})" in section
    assert not re.search(rf"`({'|'.join(HIDDEN)})`", general)


def test_what_a_method_sets_otherwise_is_shown():
    text = methods()
    assert "| `density.end` | `0.47` |" in text  # sugar
    assert "`damp-grazing True`" in text
    assert "| `trainer.base-cells` | `48` | `32` |" in text


def test_every_command_that_has_commands_is_described_with_them():
    words = list(all_words())
    assert {word[0] for word in words if word} == {command.name for command in (*USUAL, *RARE)}
    assert {word[1] for word in words if word[:1] == ("bench",) and len(word) > 1} == set(COMMANDS)
    assert ("data", "pose-board") in words
    assert ("data", "inspect") in words
    assert {word[2] for word in words if word[1:2] == ("--format",)} == set(registry.export_formats())


@pytest.mark.parametrize(
    "words", [("bench",), ("bench", "suite"), ("eval",), ("report",), ("export", "--format", "stl")]
)
def test_the_help_is_what_the_command_says(words: tuple[str, ...]):
    assert help_of(words).startswith(f"usage: sculpt-{words[0]}")
