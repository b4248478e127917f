"""``sculpt-report --help``, and a mistake: neither costs a heavy import."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "viser", "trimesh", "cv2", "numpy", "scipy", "numba", "igl", "PIL")


@pytest.mark.parametrize("words", [["--help"], []])
def test_help_and_mistakes_import_nothing_heavy(words: list[str]):
    script = (
        "import sys\n"
        f"sys.argv = ['sculpt-report', '--out', 'x', *{words!r}]\n"
        "from sculpt_framework.cli.report import main\n"
        "try:\n    main()\n"
        f"finally:\n    sys.stdout.write('|' + ','.join(sorted(set({HEAVY!r}) & set(sys.modules))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8"
    )
    assert done.stdout.endswith("|"), done.stdout
    assert done.returncode == (0 if words else 2)
    assert done.stderr == (
        "" if words else "error: nothing to compare: give run directories, or folders with runs in them.\n"
    )
