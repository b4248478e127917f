"""The commands of docs/guide/own-object.md, as they stand there, on photographs with a sparse model of COLMAP."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from layouts import make_shots, save_jpeg, write_colmap

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "own-object.md"
MODULES = {"sculpt-data": "data", "sculpt-train": "train", "sculpt-export": "export"}


def _commands() -> list[list[str]]:
    """Each once, in the order of the page, but for those that pose photographs (tests/posing) and wait for a person."""
    found = re.findall(r"(?:^    |`)(sculpt-(?:data|train|export) [^`\n]+)", PAGE.read_text(encoding="utf-8"), re.M)
    kept = [
        line
        for line in dict.fromkeys(found)
        if not re.search("RUN_DIR|--attributes$|^sculpt-data (pose|box)|--data photographs", line)
    ]
    return [shlex.split(line) for line in kept]


def _run(words: list[str], folder: Path) -> str:
    command = [sys.executable, "-m", f"sculpt_framework.cli.{MODULES[words[0]]}", *words[1:]]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=1200, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr}"
    return done.stdout


@pytest.mark.slow
def test_four_steps(tmp_path: Path):
    pytest.importorskip("xatlas")
    shots = make_shots(24, 160)
    points = np.random.default_rng(0).normal(size=(200, 3))
    points *= 0.8 / np.linalg.norm(points, axis=1, keepdims=True)
    scene = write_colmap(tmp_path / "scene", shots, points=points, masks=False)
    generator = np.random.default_rng(1)
    for shot in shots:
        # A room that cameras of a phone would see: no plain background, so that the object has to be cut out.
        behind = cv2.resize(generator.integers(60, 160, (5, 5, 3), dtype=np.uint8), (160, 160))
        behind[..., 2] //= 4
        warm = shot.image[..., :3] // 2 + np.array([0, 40, 110], np.uint8)
        save_jpeg(scene / "images" / f"{shot.name}.png", np.where(shot.image[..., 3:] > 0, warm, behind))
    commands = _commands()
    assert [words[0] for words in commands] == [*["sculpt-data"] * 2, "sculpt-train", *["sculpt-export"] * 2]
    inspect, masks, train, *exports = commands
    assert "the object is cut out of them" in _run(inspect, tmp_path)
    assert cv2.imread(str(tmp_path / "look.png")) is not None
    assert "24 masks" in _run(masks, tmp_path)
    # What was found is read in place of being found again.
    assert "24 of 24 images have a mask in a file of its own" in _run(["sculpt-data", "inspect", "scene"], tmp_path)
    assert train[1] == "gaussian-sculpting"
    _run([train[0], "gaussian-sculpting-tiny", *train[2:], "--steps", "8"], tmp_path)
    for words in exports:
        _run(words, tmp_path)
    (mesh,) = trimesh.load_scene(tmp_path / "outputs/mine/mesh-20000-textured.glb").geometry.values()
    assert mesh.visual.kind == "texture"
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.median(np.abs(radii - 0.8)) < 0.05
    assert cv2.VideoCapture(str(tmp_path / "mine.mp4")).read()[0]
    # For looking at.
    pictures = PAGE.parents[2] / "outputs" / "own-object-tests"
    pictures.mkdir(parents=True, exist_ok=True)
    shutil.copy(tmp_path / "look.png", pictures)
