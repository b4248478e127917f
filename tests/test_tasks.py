"""docs/guide/tasks.md, word for word: its commands are run in their order."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "guide" / "tasks.md"
MADE = ("mine/mesh.ply", "mine/report.html", "look.png", "mine.stl", "dense/mesh.ply", "longer/mesh.ply")


@pytest.mark.slow
def test_the_tasks_can_be_done_as_the_page_says(tmp_path: Path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    blocks = re.findall(r"^```(sh|python)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 9
    for language, block in blocks:
        command = ["bash", "-ec", block] if language == "sh" else [sys.executable, "-c", block]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
            encoding="utf-8",
        )
        assert done.returncode == 0, block + done.stderr
    for name in (*MADE, "compared/report.html"):
        assert (tmp_path / "outputs" / name).stat().st_size > 0


def test_the_readme_leads_to_the_tasks():
    assert "docs/guide/tasks.md" in (ROOT / "README.md").read_text(encoding="utf-8")
