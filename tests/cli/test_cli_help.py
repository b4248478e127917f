"""Help: what it says and what it imports."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from sculpt_framework import registry
from sculpt_framework.command_line.request import PAPER, overview, parse

HEAVY = ("torch", "viser", "trimesh", "cv2", "numpy", "scipy", "numba")


@pytest.fixture(autouse=True)
def plain_terminal(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", "1")


@pytest.mark.usefixtures("fake")
def test_the_help_of_a_method_has_what_a_person_sets_and_the_options_of_what_the_words_choose(
    capsys: pytest.CaptureFixture[str],
):
    with pytest.raises(SystemExit) as caught:
        parse(["fake", "--field", "fancy", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    shown = re.findall(r"^\W*--([a-z][a-z0-9.-]*)", text, re.MULTILINE)
    assert {"data", "output", "max-time", "seed", "resume", "field", "losses"} <= set(shown)
    assert {name.partition(".")[0] for name in shown if "." in name} == {"field"}
    assert "A method that cannot train." in text
    assert "A field with many settings, one of every type." in text
    assert re.search(r"--field\.num-levels INT\s+Levels of the grid\. \(default: 7\)", text)
    assert re.search(r"--field\.decoder \{linear,deep\}\s+What reads the grid\. \(default: linear\)", text)
    assert re.search(r"--data .*\s+Folder of the scene, or demo, or demo:NAME\. \(required\)", text)


def test_a_method_that_cannot_be_imported_is_listed_as_such(install):
    install("torn", {"sculpt_framework.methods": {"torn": "torn:torn", "gone": "no_such_module:gone"}}, torn="1 / 0")
    lines = {line.split()[0]: line for line in overview().splitlines() if line.startswith("  ")}
    assert lines["torn"].endswith("(not available: division by zero)")
    assert lines["gone"].endswith("(not available: No module named 'no_such_module')")


@pytest.mark.usefixtures("fake")
def test_overview_lists_methods_with_the_first_line_of_their_docstrings():
    assert "  fake                           A method that cannot train.\n" in overview()


@pytest.mark.parametrize("method", registry.method_names())
def test_the_help_has_some_thirty_options_and_counts_the_others(method: str, capsys: pytest.CaptureFixture[str]):
    def shown(word: str) -> tuple[str, int]:
        with pytest.raises(SystemExit):
            parse([method, word])
        text = capsys.readouterr().out
        return text, len(re.findall(r"^[│ ]+--[a-z]", text, re.MULTILINE))

    (usual, some), (_, every) = shown("--help"), shown("--help-all")
    assert some < 36
    counted = int(re.findall(r"--help-all lists (\d+) options more", usual)[0])
    # An option whose names take two lines is one; stages have several under a number.
    assert abs(some + counted - every) <= 8


def test_the_overview_names_every_built_in_method_once():
    """By a line of its own, or, at the size of its paper, in one line with the others."""
    listed = overview().partition("methods:\n")[2].partition("\n\n")[0]
    lines = dict(line.strip().split(maxsplit=1) for line in listed.splitlines())
    *_, of_paper = lines.pop(f"NAME{PAPER}").partition(": ")
    names = [*lines, *(f"{name}{PAPER}" for name in of_paper.rstrip(".").split(", "))]
    assert sorted(names) == sorted(registry.method_names())
    assert not [line for line in lines.values() if "not available" in line]


@pytest.mark.parametrize("words", ["--help", "gaussian-sculpting --help"])
def test_help_imports_nothing_heavy(words: str):
    script = (
        "import sys, runpy\n"
        f"sys.argv = ['sculpt-train', *{words.split()!r}]\n"
        "from sculpt_framework.cli.train import main\n"
        "try:\n    main()\n"
        "finally:\n"
        f"    sys.stderr.write(','.join(sorted(set({HEAVY!r}) & set(sys.modules))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "usage: sculpt-train" in done.stdout


def test_a_reader_that_closes_early_gets_no_traceback():
    script = "from sculpt_framework.cli.train import main; main()"
    command = [sys.executable, "-c", script, "gaussian-sculpting", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) == 141


def test_the_console_script_is_installed():
    script = Path(sys.executable).with_name("sculpt-train")
    done = subprocess.run([script, "--help"], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8")
    assert (done.returncode, done.stderr) == (0, "")
    assert "gaussian-sculpting-fine" in done.stdout
