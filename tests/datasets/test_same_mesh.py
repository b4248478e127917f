"""One scene in every layout gives the same mesh: what layouts round differently is far below what a seed changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from layouts import WRITERS, make_shots

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.session import Session
from sculpt_framework.evaluation.geometry import chamfer
from sculpt_framework.sculpting.config import StageConfig
from sculpt_framework.sculpting.reconstruction import Reconstruction
from sculpt_methods.sculpting import gaussian_sculpting_tiny
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig

FIRST = "NeRF-Synthetic"


def _method(seed: int) -> MethodConfig:
    base = gaussian_sculpting_tiny()
    stage = StageConfig(share=1.0, level=0, image_scale=1.0, inner_steps=2, outer_views=2)
    trainer = replace(base.trainer, base_cells=12, polish_steps=0, stages=(stage,))
    return replace(base, observers=(), data="written", seed=seed, steps=6, trainer=trainer)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    shots, root = make_shots(10, 64), tmp_path_factory.mktemp("layouts")
    return {name: write(root / name.replace(" ", "-"), shots) for name, write in WRITERS.items()}


def _train(folder: Path, seed: int = 0) -> Reconstruction:
    scene = AutoDatasetConfig().build(str(folder)).load()
    return Session(scene, _method(seed)).run()


@pytest.fixture(scope="module")
def first(folders: dict[str, Path]) -> Reconstruction:
    return _train(folders[FIRST])


@pytest.fixture(scope="module")
def noise(folders: dict[str, Path], first: Reconstruction) -> float:
    """Chamfer distance, in world units, of a run that differs in its seed alone."""
    return chamfer(first.mesh, _train(folders[FIRST], seed=1).mesh, samples=20_000).point_to_surface


# COLMAP's two encodings and IDR's two names give the same scene, which test_layouts.py holds.
@pytest.mark.slow
@pytest.mark.parametrize("layout", ["OmniObject3D", "nerfstudio", "COLMAP text", "IDR"])
def test_same_mesh(layout: str, folders: dict[str, Path], first: Reconstruction, noise: float):
    other = _train(folders[layout])
    np.testing.assert_array_equal(other.faces, first.faces)
    distance = np.linalg.norm(other.vertices - first.vertices, axis=1).max()
    assert noise > 1e-4  # Else the bar would be none.
    assert distance < 0.01 * noise
