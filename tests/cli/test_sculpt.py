"""``sculpt``: the commands under one name."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from sculpt_framework.cli.sculpt import RARE, USUAL

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))


def sculpt(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sculpt_framework.cli.sculpt", *words],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )


def test_every_program_is_a_command():
    scripts = {name: target for name, target in PROJECT["project"]["scripts"].items() if name != "sculpt"}
    known = {f"sculpt-{each.name}": f"sculpt_framework.cli.{each.module}:main" for each in (*USUAL, *RARE)}
    assert known == scripts


@pytest.mark.parametrize("words", [(), ("--help",), ("-h",)])
def test_they_are_listed(words: tuple[str, ...]):
    done = sculpt(*words)
    assert done.returncode == 0
    assert all(f"  {each.name} " in done.stdout for each in (*USUAL, *RARE))


def test_one_is_run_as_the_program_of_its_name():
    done = sculpt("report", "--help")
    assert done.returncode == 0
    assert "sculpt-report" in done.stdout


def test_one_that_there_is_not_is_said_with_the_nearest():
    done = sculpt("trian")
    assert done.returncode == 2
    assert done.stderr == "error: trian: there is no such command; did you mean train? sculpt --help lists them.\n"
