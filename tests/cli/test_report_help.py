"""``sculpt-report --help``: what it says, and that it costs no heavy import."""

import subprocess
import sys
from collections.abc import Callable

import pytest

from sculpt_framework.cli.report import report

HEAVY = ("torch", "viser", "trimesh", "cv2", "numpy", "scipy", "numba", "igl", "PIL")


def test_the_help_is_frozen(
    capsys: pytest.CaptureFixture[str], snapshot: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", "1")
    with pytest.raises(SystemExit) as caught:
        report(["--help"])
    assert caught.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    snapshot("help-report", "".join(f"{line.rstrip()}\n" for line in lines))


@pytest.mark.parametrize("words", [["--help"], []])
def test_help_and_mistakes_import_nothing_heavy(words: list[str]):
    script = (
        "import sys\n"
        f"sys.argv = ['sculpt-report', '--out', 'x', *{words!r}]\n"
        "from sculpt_framework.cli.report import main\n"
        "try:\n    main()\n"
        f"finally:\n    sys.stdout.write('|' + ','.join(sorted(set({HEAVY!r}) & set(sys.modules))))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.endswith("|"), done.stdout
    assert done.returncode == (0 if words else 2)
    assert done.stderr == (
        "" if words else "error: nothing to compare: give run directories, or folders with runs in them.\n"
    )
