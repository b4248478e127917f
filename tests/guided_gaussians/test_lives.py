"""Gaussians beside a field live the whole life of a run."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import sculpt_framework as sculpt
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.checkpoint import split_best
from sculpt_framework.engine.run import load_finished
from sculpt_framework.errors import CheckpointError, DataError
from sculpt_framework.export.saved_gaussians import GAUSSIANS_NAME
from sculpt_framework.guided_gaussians.config import GuidedGaussiansConfig
from sculpt_framework.reconstructor import Moment
from sculpt_framework.stress.small import small_scene
from sculpt_plugins.methods.gsdf.config import GsdfConfig
from tests.learning import beginning_of

NAMES = ["3dgsr", "gsdf"]


def small(name: str, steps: int) -> GuidedGaussiansConfig:
    config = sculpt.methods[name]()
    assert isinstance(config, GuidedGaussiansConfig)
    if isinstance(config, GsdfConfig):
        radiance = replace(config.radiance, num_levels=3, log2_table=12, finest_resolution=32, hidden_units=16)
        config = replace(config, radiance=radiance)
    density = replace(config.density, every=10)
    rays = replace(config.rays, number=128, steps_across=48, cells=24)
    sizes = {"gaussians": 600, "mesh_cells": 32}
    return replace(config, steps=steps, density=density, rays=rays, **sizes)


@pytest.mark.parametrize("name", ["gsdf", pytest.param("3dgsr", marks=pytest.mark.slow)])
def test_it_learns_the_shape_and_is_drawn_as_it_was(tmp_path: Path, name: str):
    folder = tmp_path / "blob"
    settings = DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32)
    write_scene(demo_object("blob"), settings, folder)
    session = sculpt.Session(sculpt.load(str(folder)), small(name, 90))
    first = beginning_of(session)
    session.run()
    last = session.curve[-1]
    assert last["chamfer_ps"] < 0.75 * first["chamfer_ps"]
    assert last["psnr"] > first["psnr"] + 2
    mesh = session.mesh()
    assert mesh.to_trimesh().is_watertight
    assert np.ptp(mesh.colors, axis=0).max() > 0.02
    session.save(tmp_path / "run")
    saved, camera = load_finished(tmp_path / "run"), session.scene.test[0].camera
    drawn, own = saved.config.renderer(tmp_path / "run", saved.scene)(camera), session.render(camera)
    assert torch.allclose(drawn.rgb, own.rgb, atol=2e-3)
    (tmp_path / "run" / GAUSSIANS_NAME).unlink()
    with pytest.raises(CheckpointError, match=GAUSSIANS_NAME):
        saved.config.renderer(tmp_path / "run", saved.scene)


def test_the_gaussians_of_gsdf_are_alone_at_first_and_what_the_field_begins_with_is_no_result():
    best: list[Mapping[str, torch.Tensor]] = []
    session = sculpt.Session(
        small_scene(), small("gsdf", 12), save_state=lambda state, progress: best.append(split_best(state)[1])
    )
    reports, stages = [], []
    for report in session:
        reports.append(report)
        stages.append(session.reconstructor.stage)
    alone = {"color"}
    assert set(reports[2].terms) == alone
    assert {"ray color", "eikonal", "mask", "depth", "normal"} == set(reports[-1].terms) - alone
    assert session.reconstructor.stages == 3
    assert stages == [0] * 5 + [1] * 4 + [2] * 4
    assert int(best[-1]["taken"]) >= 8
    assert [row["reason"] for row in session.curve].count("stage") == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gone_on_with_it_is_what_it_would_have_been(name: str):
    states: dict[int, dict[str, torch.Tensor]] = {}
    session = sculpt.Session(small_scene(), small(name, 40))
    method = session.reconstructor
    for report in session:
        states[report.step] = method.state()
    again = sculpt.Session(small_scene(), small(name, 40)).reconstructor
    again.load_state(states[10])
    for step in range(10, 40):
        moment = Moment(step=step, progress=step / 40)
        again.settle(moment)
        again.step(moment)
    for key, value in again.state().items():
        # What was measured last is told, not learned from.
        assert key == "faces" or torch.equal(value, states[40][key]), key
    assert len(states[40]["means"]) != len(states[10]["means"])


def test_images_without_masks_are_refused():
    scene = small_scene()
    bare = replace(scene, train=tuple(replace(view, alpha=None) for view in scene.train))
    with pytest.raises(DataError, match=r"3dgsr learns.*masks.*gaussian-sculpting"):
        sculpt.Session(bare, small("3dgsr", 5)).run()
