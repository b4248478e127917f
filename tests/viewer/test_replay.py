"""A run steered by a client of its page, and the same done again by ``--replay``."""

import subprocess
from pathlib import Path

import pytest

from sculpt_framework.testing.viewer_client import announce, connected, find_control, set_control

from .training import STEPS, Run, train_words

pytestmark = pytest.mark.slow


def give(run: Run, kind: str, label: str, value: object) -> None:
    """As a browser does that has just been opened."""
    with connected(run.address) as client:
        announce(client)
        set_control(client, find_control(client, kind, label), value)
        client.close()


def test_a_steered_run_is_done_again_without_a_browser(tmp_path: Path):
    run = Run(tmp_path, 7034)
    try:
        run.wait_for_steps(1)
        give(run, "GuiSliderMessage", "Of the surface, times", 2.0)
        run.wait_for_command(do="set-rate", part="surface", factor=2.0)
        give(run, "GuiNumberMessage", "silhouette", 3.0)
        run.wait_for_command(do="set-weight", name="silhouette", weight=3.0)
        give(run, "GuiButtonMessage", "Place a box", True)
        give(run, "GuiButtonMessage", "Refine here", True)
        run.wait_for_command(do="add-box", kind="refine")
        run.wait_for_steps(2)
        give(run, "GuiButtonMessage", "Stop and save", True)
        assert run.process.wait(timeout=120) == 0, run.log.read_text(encoding="utf-8")
    finally:
        run.kill()
    assert 0 < run.steps < STEPS
    again = tmp_path / "again"
    words = train_words(again, "--steps", str(STEPS), "--replay", str(run.folder / "events.jsonl"))
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    assert (again / "mesh.ply").read_bytes() == (run.folder / "mesh.ply").read_bytes()
    assert (again / "gaussians.ply").read_bytes() == (run.folder / "gaussians.ply").read_bytes()
