"""A run steered by a client of its page, and the same done again by ``--replay``."""

import subprocess
from pathlib import Path

import pytest

from sculpt_framework.testing.viewer_client import given

from .training import STEPS, Run, train_words

pytestmark = pytest.mark.slow


def test_a_steered_run_is_done_again_without_a_browser(tmp_path: Path):
    run = Run(tmp_path, 7034)
    try:
        run.wait_for_steps(1)
        with given(run.address, "GuiSliderMessage", "Of the surface, times", 2.0):
            run.wait_for_command(do="set-rate", part="surface", factor=2.0)
        with given(run.address, "GuiNumberMessage", "silhouette", 3.0):
            run.wait_for_command(do="set-weight", name="silhouette", weight=3.0)
        # The second button is shown once the box stands.
        box, refine = (given(run.address, "GuiButtonMessage", label, True) for label in ("Place a box", "Refine here"))
        with box, refine:
            run.wait_for_command(do="add-box", kind="refine")
        run.wait_for_steps(2)
        with given(run.address, "GuiButtonMessage", "Stop and save", True):
            code = run.process.wait(timeout=120)
        assert code == 0, run.log.read_text(encoding="utf-8")
    finally:
        run.kill()
    assert 0 < run.steps < STEPS
    again = tmp_path / "again"
    words = train_words(again, "--steps", str(STEPS), "--replay", str(run.folder / "events.jsonl"))
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    assert (again / "mesh.ply").read_bytes() == (run.folder / "mesh.ply").read_bytes()
    assert (again / "gaussians.ply").read_bytes() == (run.folder / "gaussians.ply").read_bytes()
