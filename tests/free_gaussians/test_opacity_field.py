"""GOF: the opacity of places, and the mesh of a level of it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import sculpt_framework as sculpt
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import DeviceError
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.free_gaussians.closing import is_closed
from sculpt_framework.geometry import topology
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.geometry.tetrahedra import march_tetrahedra
from sculpt_framework.stress.small import small_scene
from sculpt_plugins.methods.gof.config import GofConfig
from sculpt_plugins.methods.gof.drawing import RayDrawing
from sculpt_plugins.methods.gof.opacity_field import OpacityField
from sculpt_plugins.methods.gof.tetrahedra import OpacityMesher
from tests.free_gaussians.shapes import CAMERA, ball, on_a_sphere
from tests.learning import beginning_of

EXACTLY = 1.0
"""Opacity that is never reached: nothing is left out that could change it."""


def config() -> GofConfig:
    made = sculpt.methods["gof"]()
    assert isinstance(made, GofConfig)
    return made


def test_the_opacity_up_to_a_ball_rises_to_its_peak_and_stays():
    field = OpacityField(ball(), [CAMERA], 0.0)
    heights = np.array([-0.9, -0.4, 0.0, 0.5, 3.0])
    # Along the middle of the image, from the camera on.
    points = np.stack([0 * heights, 0 * heights, heights], axis=1)
    expected = 0.9 * np.exp(-0.5 * np.minimum(heights, 0) ** 2 / 0.25)
    assert np.allclose(field.at(points, EXACTLY), expected, rtol=1e-9)
    # Beyond the rim there is nothing; behind the camera and beside the image nothing is known.
    assert field.at(np.array([[0, 0, -1.9], [0, 0, -4.0], [9.0, 0, 0]]), EXACTLY).tolist() == [0, 0, 0]


def test_two_balls_add_up_in_any_order_and_the_least_view_counts():
    one = ball()
    two = replace(one, **{
        name: torch.cat([getattr(one, name)] * 2) for name in ("scales", "rotations", "opacities", "sh", "face")
    }, means=torch.tensor([[0.0, 0, 1.0], [0, 0, 0]]).double())  # fmt: skip
    behind = np.array([[0.0, 0, 2.0]])
    assert OpacityField(two, [CAMERA], 0.0).at(behind, EXACTLY)[0] == pytest.approx(1 - 0.1**2, rel=1e-9)
    # From the other side there is nothing before it.
    pose = CAMERA.world_to_camera.clone()
    pose[:3, :3] = torch.diag(torch.tensor([1.0, -1, -1]).double()) @ pose[:3, :3]
    pose[:3, 3] = torch.tensor([0, 0, 6.0])
    other = replace(CAMERA, world_to_camera=pose)
    assert OpacityField(two, [CAMERA, other], 0.0).at(behind, 0.5)[0] < 0.2
    inside = np.array([[0.0, 0, 0.5]])
    assert OpacityField(two, [CAMERA, other], 0.0).at(inside, 0.5)[0] >= 0.5


def test_a_sphere_of_flat_gaussians_becomes_a_sphere():
    half = on_a_sphere(800)
    cameras = [camera.to(torch.device("cpu"), torch.float64) for camera in demo_cameras(16, 200)]
    grid = grid_over_box(torch.ones(3), 16)
    made = replace(config(), mesh_gaussians=800)
    surface = OpacityMesher(made, grid).surface(RayDrawing(made), half, cameras)
    vertices = surface.vertices.numpy()
    assert is_closed(Mesh(vertices=vertices, faces=surface.faces.numpy()))
    radius = np.linalg.norm(vertices, axis=1)
    # The Gaussians are 0.01 thick, smoothing adds to it; several together are half opaque before their middle.
    assert 0.6 < np.median(radius) < 0.624
    assert np.abs(radius - np.median(radius)).max() < 0.01
    again = OpacityMesher(made, grid).surface(RayDrawing(made), half, cameras)
    assert torch.equal(surface.vertices, again.vertices)
    # Half of them, drawn at random, still see the whole field.
    fewer = OpacityMesher(replace(made, mesh_gaussians=400), grid).surface(RayDrawing(made), half, cameras)
    assert float(fewer.vertices.norm(dim=1).median()) == pytest.approx(np.median(radius), abs=1e-3)


@pytest.mark.parametrize("clear", [True, False], ids=["clear", "out of the box"])
def test_without_opacity_there_is_no_surface(clear: bool):
    some = on_a_sphere(30)
    some = replace(some, opacities=torch.zeros(30).double()) if clear else replace(some, means=some.means + 50)
    made = config()
    with pytest.raises(EmptySurfaceError, match=r"opacity of 0\.5 from all sides"):
        OpacityMesher(made, grid_over_box(torch.ones(3), 16)).surface(RayDrawing(made), some, [CAMERA])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_marched_tetrahedra_are_closed_and_outward(seed: int):
    random = np.random.default_rng(seed)
    signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(8, 3)
    corners = np.concatenate([4 * signs, random.uniform(-1, 1, (60, 3))])
    inside = random.random(len(corners)) < 0.4
    inside[:8] = False
    cut = march_tetrahedra(corners, Delaunay(corners).simplices.astype(np.int64), inside)
    if not inside.any():
        assert len(cut.faces) == 0
        return
    assert inside[cut.ends[:, 0]].all()
    assert not inside[cut.ends[:, 1]].any()
    vertices = corners[cut.ends].mean(axis=1)
    assert is_closed(Mesh(vertices=vertices, faces=cut.faces))
    assert topology.is_vertex_manifold(cut.faces)


def test_one_corner_inside_is_a_piece_of_known_volume():
    corners = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    octants = [[0, a, b, c] for a in (1, 4) for b in (2, 5) for c in (3, 6)]
    cut = march_tetrahedra(corners, np.array(octants), np.arange(7) == 0)
    vertices = corners[cut.ends].mean(axis=1)
    assert topology.signed_volume(vertices, cut.faces) == pytest.approx(4 / 3 / 8)


def test_it_is_for_the_cpu():
    with pytest.raises(DeviceError, match="gof draws its Gaussians on the CPU"):
        replace(config(), device="cuda").pick_device()


@pytest.mark.slow
def test_it_learns():
    made = config()
    small = replace(made, steps=150, gaussians=600, mesh_cells=32, density=replace(made.density, every=10))
    session = sculpt.Session(small_scene(), replace(small, holdout_every=4))
    first = beginning_of(session)
    session.run()
    assert session.curve[-1]["psnr"] > first["psnr"] + 4
    assert session.mesh().to_trimesh().is_watertight
