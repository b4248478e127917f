"""Free Gaussians: how they are counted, how they multiply, what their depths are fused to, a run's whole life."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import sculpt_framework as sculpt
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.checkpoint import split_best
from sculpt_framework.engine.run import load_finished
from sculpt_framework.errors import ConfigError
from sculpt_framework.free_gaussians.config import DensityConfig, FreeGaussiansConfig, GaussianRates
from sculpt_framework.free_gaussians.splats import Splats
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.reconstructor import Moment
from sculpt_framework.shape_from_images.tsdf import fuse_renderings, surface_of
from sculpt_framework.stress.small import small_scene
from sculpt_framework.types import Camera, Rendering
from sculpt_framework.validation import check
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.methods.sugar.config import PoissonConfig, SugarConfig
from tests.learning import beginning_of

RATES = GaussianRates()


def small(steps: int, name: str = "splatting-3d") -> FreeGaussiansConfig:
    config = sculpt.methods[name]()
    assert isinstance(config, FreeGaussiansConfig)
    return replace(config, steps=steps, gaussians=600, mesh_cells=32, density=replace(config.density, every=10))


def splats(count: int) -> Splats:
    return Splats.at_random(torch.ones(3), count, 1, RATES, torch.Generator().manual_seed(0))


def sphere_rendering(camera: Camera, radius: float) -> Rendering:
    """Depth and coverage of a ball around the origin, exactly at the pixels' centres."""
    columns, rows = torch.meshgrid(torch.arange(camera.width) + 0.5, torch.arange(camera.height) + 0.5, indexing="xy")
    ray = torch.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, torch.ones_like(rows)], 2)
    middle = camera.world_to_camera[:3, 3].float()
    along = (ray @ middle) / ray.square().sum(2)
    left = along.square() - (middle.square().sum() - radius**2) / ray.square().sum(2)
    hit = left > 0
    depth = torch.where(hit, along - left.clamp(min=0).sqrt(), 0.0)
    return Rendering(rgb=torch.zeros(*depth.shape, 3), alpha=hit.float(), depth=depth)


def test_depths_of_a_ball_are_fused_to_a_ball():
    grid = grid_over_box(torch.ones(3), 48)
    cameras = [replace(camera, world_to_camera=camera.world_to_camera.float()) for camera in demo_cameras(20, 200)]
    volume = fuse_renderings([(camera, sphere_rendering(camera, 0.6)) for camera in cameras], grid)
    level, seeds = surface_of(volume, grid, torch.device("cpu"))
    surface = MarchingTetrahedraConfig().build(grid, torch.device("cpu")).extract(level, seeds).surface
    radius = surface.vertices.norm(dim=1)
    assert float((radius - 0.6).abs().mean()) < 0.15 * grid.cell
    assert float((radius - 0.6).abs().max()) < grid.cell
    # What one view hides is inside, what lies in no image is not.
    camera = replace(cameras[0], width=100, cx=100.0 - 50.0)
    (one,) = [fuse_renderings([(camera, sphere_rendering(camera, 0.6))], grid)]
    values = one.interpolator(torch.device("cpu"))
    towards = camera.position / camera.position.norm()
    assert float(values(-0.9 * towards[None])) < 0
    assert float(values(0.9 * towards[None])) > 0
    assert (fuse_renderings([], grid).values > 0).all()


def test_the_pull_in_the_image_is_that_of_its_own_place():
    """The gradient by the place in the image, told from that in space, against one taken through the projection."""
    camera = Camera(
        world_to_camera=torch.tensor([[0.8, 0.6, 0, 0.1], [-0.6, 0.8, 0, 0.2], [0, 0, 1, 3], [0, 0, 0, 1]]),
        fx=120.0, fy=100.0, cx=50.0, cy=40.0, width=100, height=80,
    )  # fmt: skip
    some = splats(5)
    local = some.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = torch.stack([local[:, 0] / local[:, 2] * camera.fx, local[:, 1] / local[:, 2] * camera.fy], dim=1)
    slope = torch.tensor([[0.3, -0.4], [1.0, 0.0], [0.0, 2.0], [0.0, 0.0], [-1.0, 1.0]])
    (pixels * slope).sum().backward()
    some.note(camera)
    halves = slope * torch.tensor([camera.width / 2, camera.height / 2])
    assert torch.allclose(some.pull, halves.norm(dim=1), rtol=1e-4)
    assert some.shown.tolist() == [1, 1, 1, 0, 1]


def test_what_is_cloned_split_and_dropped():
    some = splats(4)
    density = DensityConfig(gradient=1.0, large=0.1, least_opacity=0.01, most=100)
    with torch.no_grad():
        some.parameters["log_scales"][:] = math.log(0.05)
        some.parameters["log_scales"][1] = math.log(0.2)
        some.parameters["logits"][3] = -10.0
    for parameter in some.parameters.values():
        parameter.grad = torch.ones_like(parameter)
    some.step(1.0, 1.0)
    before = {name: value.detach().clone() for name, value in some.parameters.items()}
    some.pull, some.shown = torch.tensor([2.0, 6.0, 0.5, 9.0]), torch.tensor([1.0, 2.0, 1.0, 1.0])
    # The first is cloned, the second split, the third left alone, the fourth dropped, however it is pulled at.
    after = some.renewed(density, torch.Generator().manual_seed(1))
    means, sizes = after.means.detach(), after.parameters["log_scales"].detach().exp()
    assert len(after) == 5
    assert torch.equal(means[:3], before["means"][[0, 2, 0]])
    assert torch.allclose(sizes[3:], before["log_scales"][1].exp() / 1.6)
    assert 0 < float((means[3:] - before["means"][1]).norm(dim=1).max()) < 1.0
    moments = after.optimizer.state()["0.exp_avg"]
    assert (moments[:2] != 0).all()
    assert (moments[2:] == 0).all()
    assert after.pull.tolist() == [0] * 5
    # No room is no reason to lose one.
    assert len(some.renewed(replace(density, most=4), torch.Generator())) == 3
    with pytest.raises(EmptySurfaceError, match="no Gaussian"):
        splats(3).renewed(replace(density, least_opacity=0.5), torch.Generator())


def test_opacities_fall_and_forget_how_they_moved():
    some = splats(3)
    for parameter in some.parameters.values():
        parameter.grad = torch.ones_like(parameter)
    some.step(1.0, 1.0)
    with torch.no_grad():
        some.parameters["logits"][:] = torch.tensor([0.9, 0.005, 0.01]).logit()
    some.pull, some.shown = torch.arange(3.0), torch.ones(3)
    after = some.dimmed(0.01)
    assert torch.allclose(after.parameters["logits"].sigmoid(), torch.tensor([0.01, 0.005, 0.01]))
    before, now = some.optimizer.state(), after.optimizer.state()
    changed = {name for name in before if not torch.equal(before[name], now[name])}
    logits = list(some.parameters).index("logits") - 1
    assert changed == {f"{logits}.exp_avg", f"{logits}.exp_avg_sq"}
    assert all((now[name] == 0).all() for name in changed)
    assert torch.equal(after.pull, some.pull)
    for name, value in some.parameters.items():
        assert name == "logits" or torch.equal(value, after.parameters[name])


@pytest.mark.parametrize("least", [0.0, 0.5])
def test_a_reset_has_an_opacity_to_fall_to(least: float):
    config = small(10)
    check(replace(config, density=replace(config.density, least_opacity=least)))
    config = replace(config, density=replace(config.density, least_opacity=least, reset_every=5))
    with pytest.raises(ConfigError, match=r"^--density\.least-opacity is 0(\.5)?; expected above 0, below 0\.5 with"):
        check(config)


def test_the_harmonics_come_one_degree_after_the_other_and_columns_are_sorted():
    some = splats(3)
    with torch.no_grad():
        some.parameters["log_scales"][:] = torch.tensor([[-1.0, -3.0, -2.0]])
        some.parameters["quaternions"][:] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    gaussians = some.gaussians(4)
    assert gaussians.sh.shape == (3, 4, 3)
    assert torch.equal(gaussians.scales.argsort(dim=1), torch.arange(3).expand(3, 3))
    assert torch.equal(gaussians.rotations[0, :, 0].detach(), torch.tensor([0.0, 1.0, 0.0]))


def test_it_learns_and_is_drawn_as_it_was(tmp_path: Path):
    folder = tmp_path / "blob"
    settings = DemoSettings(train_views=12, test_views=2, resolution=48, reference_cells=32)
    write_scene(demo_object("blob"), settings, folder)
    session = sculpt.Session(sculpt.load(str(folder)), replace(small(150), holdout_every=4))
    first = beginning_of(session)
    session.run()
    last = session.curve[-1]
    assert last["psnr"] > first["psnr"] + 4
    assert last["gaussians"] > 600
    assert session.mesh().to_trimesh().is_watertight
    assert np.ptp(session.mesh().colors, axis=0).max() > 0.02
    session.save(tmp_path / "run")
    saved, camera = load_finished(tmp_path / "run"), session.scene.train[0].camera
    drawn, own = saved.config.renderer(tmp_path / "run", session.scene)(camera), session.render(camera)
    assert torch.allclose(drawn.rgb, own.rgb, atol=2e-3)


@pytest.mark.parametrize(
    ("name", "begin", "without"),
    [
        ("gof", 0.5, {"distortion": 0.0, "normals": 0.0}),
        ("splatting-2d", 0.23, {"distortion_from": 0.0, "normals": 0.0}),
        ("pgsr", 0.23, {"single_view": 0.0, "geometric": 0.0, "photometric": 0.0}),
        ("relightable", 0.75, {"shaded": 0.0}),
    ],
)
def test_states_compete_once_all_terms_have_acted_for_a_while(name: str, begin: float, without: dict[str, float]):
    config = small(10, name)
    assert config.stretches == (0.5 * (1 + begin),)
    assert replace(config, **without).stretches == ()


def test_no_run_ends_with_a_state_from_before_its_terms():
    best: list[Mapping[str, torch.Tensor]] = []
    session = sculpt.Session(
        small_scene(), small(20, "pgsr"), save_state=lambda state, progress: best.append(split_best(state)[1])
    )
    session.run()
    assert [row["reason"] for row in session.curve].count("stage") == 1
    assert int(best[-1]["taken"]) >= 13


@pytest.mark.slow
@pytest.mark.parametrize("name", ["splatting-3d", "sugar", "gof"])
def test_gone_on_with_it_is_what_it_would_have_been(name: str):
    states: dict[int, dict[str, torch.Tensor]] = {}
    config = small(40, name)
    if isinstance(config, SugarConfig):
        config = replace(config, clear=0.05, samples=64, poisson=PoissonConfig(points=500, depth=4))
    session = sculpt.Session(small_scene(), config)
    method = session.reconstructor
    for report in session:
        states[report.step] = method.state()
    again = sculpt.Session(small_scene(), config).reconstructor
    again.load_state(states[10])
    for step in range(10, 40):
        moment = Moment(step=step, progress=step / 40)
        again.settle(moment)
        again.step(moment)
    for key, value in again.state().items():
        # What was measured last is told, not learned from.
        assert key == "faces" or torch.equal(value, states[40][key]), key
    assert len(states[40]["means"]) != len(states[10]["means"])


@pytest.mark.slow
def test_images_need_no_masks():
    scene = small_scene()
    bare = replace(scene, train=tuple(replace(view, alpha=None) for view in scene.train))
    assert sculpt.Session(bare, small(20)).run().to_trimesh().is_watertight


@pytest.mark.parametrize("degree", [0, 3])
def test_a_start_at_random_fills_the_box(degree: int):
    some = Splats.at_random(torch.tensor([1.0, 0.5, 0.25]), 500, degree, RATES, torch.Generator().manual_seed(0))
    assert torch.allclose(some.means.detach().abs().amax(dim=0), torch.tensor([1.0, 0.5, 0.25]), rtol=0.05)
    assert some.parameters["rest"].shape == (500, (degree + 1) ** 2 - 1, 3)
