"""The methods that render a volume live the whole life of a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import sculpt_framework as sculpt
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.run import load_finished
from sculpt_framework.errors import CheckpointError, ConfigError, DataError
from sculpt_framework.reconstructor import Moment
from sculpt_framework.stress.small import small_scene
from sculpt_framework.validation import check
from sculpt_framework.volume_rendering.config import VolumeConfig
from sculpt_framework.volume_rendering.reconstructor import FILE_NAME
from sculpt_plugins.methods.gsdf.config import GsdfConfig

NAMES = ["nerf", "neus", "volsdf"]
# Their parts have tests of their own, and one of them lives a quick run.
ONE_QUICK = ["neus", *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES if name != "neus")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("volumes") / "blob"
    write_scene(demo_object("blob"), DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32), out)
    return out


def small(name: str, steps: int) -> VolumeConfig:
    config = sculpt.methods[name]()
    assert isinstance(config, VolumeConfig)
    radiance = replace(config.radiance, num_levels=3, log2_table=12, finest_resolution=32, hidden_units=16)
    return replace(config, steps=steps, rays=256, steps_across=48, cells=24, mesh_cells=32, radiance=radiance)


@pytest.mark.parametrize("name", ONE_QUICK)
def test_it_learns_the_shape_and_is_drawn_as_it_was(folder: Path, tmp_path: Path, name: str):
    session = sculpt.Session(sculpt.load(str(folder)), small(name, 150))
    session.run()
    first, last = session.curve[0], session.curve[-1]
    assert last["chamfer_ps"] < 0.75 * first["chamfer_ps"]
    assert last["psnr"] > first["psnr"] + 2
    mesh = session.mesh()
    assert mesh.to_trimesh().is_watertight
    assert np.ptp(mesh.colors, axis=0).max() > 0.02
    session.save(tmp_path / "run")
    saved, camera = load_finished(tmp_path / "run"), session.scene.test[0].camera
    drawn, own = saved.config.renderer(tmp_path / "run", saved.scene)(camera), session.render(camera)
    assert torch.allclose(drawn.rgb, own.rgb, atol=1e-5)
    (tmp_path / "run" / FILE_NAME).write_bytes(b"")
    with pytest.raises(CheckpointError, match=FILE_NAME):
        saved.config.renderer(tmp_path / "run", saved.scene)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gone_on_with_it_is_what_it_would_have_been(name: str):
    states: dict[int, dict[str, torch.Tensor]] = {}
    session = sculpt.Session(small_scene(), small(name, 20))
    method = session.reconstructor
    for report in session:
        states[report.step] = method.state()
    assert not torch.equal(states[10]["random"], states[20]["random"])
    again = sculpt.Session(small_scene(), small(name, 20)).reconstructor
    again.load_state(states[10])
    for step in range(10, 20):
        again.step(Moment(step=step, progress=step / 20))
    for key, value in again.state().items():
        # What was measured last is told, not learned from.
        assert key == "faces" or torch.equal(value, states[20][key]), key


@pytest.mark.parametrize("name", [*NAMES, "gsdf"])
def test_colours_have_no_finest_level_below_the_coarsest(name: str):
    config = sculpt.methods[name]()
    assert isinstance(config, VolumeConfig | GsdfConfig)
    message = r"^--radiance\.finest-resolution is 7; expected radiance\.base-resolution \(8\) or more\.$"
    with pytest.raises(ConfigError, match=message):
        check(replace(config, radiance=replace(config.radiance, finest_resolution=7)))


def test_images_without_masks_are_refused():
    scene = small_scene()
    bare = replace(scene, train=tuple(replace(view, alpha=None) for view in scene.train))
    with pytest.raises(DataError, match=r"masks.*gaussian-sculpting"):
        sculpt.Session(bare, small("neus", 5)).run()
