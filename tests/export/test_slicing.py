"""Exported STL and 3MF in PrusaSlicer, which repairs what it finds broken and says so.

apt-get install --no-install-recommends prusa-slicer; pytest -m slow tests/export/test_slicing.py
"""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from small_scene import ball, color_at

from sculpt_framework.cli.export import export
from sculpt_framework.export.mesh_files import write_mesh_ply

SLICER = shutil.which("prusa-slicer")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(SLICER is None, reason="no prusa-slicer on PATH")]


def slicer(*words: object, home: Path) -> str:
    command = [str(SLICER), *map(str, words)]
    # Its settings go where HOME is.
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
        env={"HOME": str(home), "PATH": "/usr/bin"},
        encoding="utf-8",
    )
    return done.stdout + done.stderr


@pytest.mark.parametrize("kind", ["stl", "3mf"])
def test_is_sliced_as_it_is(kind: str, tmp_path: Path):
    vertices, faces = ball(4)
    vertices = vertices * (1 + 0.1 * np.sin(5 * vertices[:, :1]))
    # As an extractor may leave them.
    vertices[faces[100, 0]] = vertices[faces[100, 1]]
    run_dir = tmp_path / "run"
    run_dir.mkdir()
    write_mesh_ply(run_dir / "mesh.ply", vertices, faces, color_at(vertices).clip(0, 1))
    out = tmp_path / f"ball.{kind}"
    words = ("--size", "30mm", "--up", "Z", "--flat-base", "--origin", "bottom-center", "--target-faces", "3000")
    export([str(run_dir), "--format", kind, "--out", str(out), *words])
    told = dict(re.findall(r"^(\w+) = +(\S+)$", slicer("--info", out, home=tmp_path), re.MULTILINE))
    assert told["manifold"] == "yes"
    assert told["number_of_parts"] == "1"
    # Among the facts there is no count of repaired edges or facets.
    assert not [name for name in told if re.search("fixed|reversed|repair|degenerate|removed|open", name)]
    assert max(float(told[f"size_{axis}"]) for axis in "xyz") == pytest.approx(30, rel=1e-5)
    assert float(told["min_z"]) == pytest.approx(0, abs=1e-5)
    code = tmp_path / "ball.gcode"
    said = slicer("--export-gcode", "--output", code, out, home=tmp_path)
    assert not re.search("repair|not watertight|empty layer", said, re.IGNORECASE)
    assert code.stat().st_size > 100_000
