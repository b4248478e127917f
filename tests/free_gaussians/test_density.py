"""SuGaR: the distance a density implies, what it teaches, and the mesh of a level of it."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.errors import ComponentImportError
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.free_gaussians.closing import closed_surface, is_closed
from sculpt_framework.free_gaussians.config import GaussianRates
from sculpt_framework.free_gaussians.drawing import Drawing, Lesson, Terms
from sculpt_framework.free_gaussians.splats import Splats
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.stress.small import small_scene
from sculpt_framework.types import Camera, Gaussians, Rendering
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.methods.sugar.config import PoissonConfig, SugarConfig
from sculpt_plugins.methods.sugar.density import density_at, implied, neighbours
from sculpt_plugins.methods.sugar.drawing import entropy, surface_terms
from sculpt_plugins.methods.sugar.poisson import PoissonMesher, level_points, poisson
from tests.free_gaussians.shapes import flat, on_a_sphere
from tests.learning import beginning_of

CPU = torch.device("cpu")
CAMERA = Camera(
    world_to_camera=torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]], dtype=torch.float64),
    fx=40.0, fy=40.0, cx=20.0, cy=20.0, width=40, height=40,
)  # fmt: skip


def config() -> SugarConfig:
    made = sculpt.methods["sugar"]()
    assert isinstance(made, SugarConfig)
    return made


def test_the_distance_of_one_flat_gaussian_is_that_from_its_plane():
    one = flat(torch.zeros(1, 3).double(), torch.tensor([[0.0, 0, 1]]).double(), 0.1, 5.0, 0.999999)
    points = torch.tensor([[0.0, 0, 0.25], [0.4, 0.2, -0.15], [0, 0, 0.02]]).double()
    found = implied(one, density_at(one, points, neighbours(one, points)))
    assert found.known.all()
    assert torch.allclose(found.distance, torch.tensor([0.25, 0.15, 0.02]).double(), atol=2e-3)
    assert float(found.off.max()) < 1e-4


def test_slopes():
    turns, _ = torch.linalg.qr(torch.rand(6, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    random = torch.Generator().manual_seed(1)
    some = Gaussians(
        means=0.3 * torch.randn(6, 3, generator=random, dtype=torch.float64),
        scales=torch.tensor([0.1, 0.3, 0.5]).double() + 0.02 * torch.rand(6, 3, generator=random, dtype=torch.float64),
        rotations=turns,
        opacities=0.1 + 0.2 * torch.rand(6, generator=random, dtype=torch.float64),
        sh=torch.zeros(6, 1, 3, dtype=torch.float64),
        face=torch.full((6,), -1),
    )
    points = 0.3 * torch.randn(5, 3, generator=random, dtype=torch.float64)
    near = neighbours(some, points)

    def values(means: Tensor, scales: Tensor, rotations: Tensor, opacities: Tensor) -> Tensor:
        given = replace(some, means=means, scales=scales, rotations=rotations, opacities=opacities)
        found = implied(given, density_at(given, points, near))
        return found.distance

    inputs = [some.means, some.scales, some.rotations, some.opacities]
    assert gradcheck(values, [each.clone().requires_grad_() for each in inputs])
    local = density_at(some, points, near)
    assert gradcheck(
        lambda rotations: implied(replace(some, rotations=rotations), local).off,
        [some.rotations.clone().requires_grad_()],
    )
    # The density's own slope is that by the place.
    where = points.clone().requires_grad_()
    local = density_at(some, where, near)
    (by_place,) = torch.autograd.grad(local.density.sum(), where)
    assert torch.allclose(local.slope, by_place)


def test_where_there_is_no_density_or_too_much_nothing_is_taught():
    one = flat(torch.zeros(1, 3).double(), torch.tensor([[0.0, 0, 1]]).double(), 0.1, 0.2, 0.9)
    # Out of reach; on the centre, where the density has no slope; in many at once.
    many = replace(one, **{
        name: getattr(one, name).repeat(3, *[1] * (getattr(one, name).ndim - 1))
        for name in ("means", "scales", "rotations", "opacities", "sh", "face")
    })  # fmt: skip
    for given, place in ((one, [9.0, 0, 0]), (one, [0.0, 0, 0]), (many, [0.0, 0, 0.01])):
        means, opacities = given.means.clone().requires_grad_(), given.opacities.clone().requires_grad_()
        moved = replace(given, means=means, opacities=opacities)
        point = torch.tensor([place]).double()
        found = implied(moved, density_at(moved, point, neighbours(moved, point)))
        (found.distance + found.off).sum().backward()
        assert float(found.distance.detach()) == 0
        for slope in (means.grad, opacities.grad):
            assert slope is not None
            assert torch.isfinite(slope).all()
    clear = replace(one, opacities=torch.zeros(1).double())
    point = torch.tensor([[0.0, 0, 0.05]]).double()
    assert not implied(clear, density_at(clear, point, neighbours(clear, point))).known.any()


def test_a_gaussian_beside_the_surface_is_pulled_onto_it():
    """The depths are those of the plane z = 0; the Gaussian is in front of it, and turned."""
    camera, depth = CAMERA, torch.full((40, 40), 3.0, dtype=torch.float64)
    seen = Rendering(rgb=torch.zeros(40, 40, 3), alpha=torch.ones_like(depth), depth=depth)
    normal = torch.nn.functional.normalize(torch.tensor([[0.2, 0.0, -1.0]]).double(), dim=1)
    one = flat(torch.tensor([[0.0, 0, -0.06]]).double(), normal, 0.05, 0.3, 0.95)
    mean = one.means.clone().requires_grad_()
    optimizer, generator = torch.optim.Adam([mean], lr=2e-3), torch.Generator().manual_seed(0)
    for _ in range(80):
        missed, _ = surface_terms(replace(one, means=mean), seen, camera, 256, generator)
        optimizer.zero_grad()
        missed.backward()
        optimizer.step()
    assert abs(float(mean[0, 2].detach())) < 0.015
    # One behind the camera, and one far behind what is seen, have no say.
    for place in (-4.0, 2.0):
        away = replace(one, means=torch.tensor([[0.0, 0, place]]).double().requires_grad_())
        missed, off = surface_terms(away, seen, camera, 16, generator)
        assert float((missed + off).detach()) == 0
        missed.backward()
        assert away.means.grad is not None
        assert (away.means.grad == 0).all()
    # Nor has anything before the background.
    empty = replace(seen, alpha=torch.zeros_like(depth), depth=torch.zeros_like(depth))
    assert float(surface_terms(one, empty, camera, 16, generator)[0]) == 0


def test_the_entropy_draws_to_clear_and_opaque():
    opacities = torch.tensor([0.2, 0.5, 0.9, 0.0, 1.0], dtype=torch.float64, requires_grad=True)
    value = entropy(opacities)
    value.backward()
    assert float(value.detach()) == pytest.approx(
        -sum(p * math.log(p) for p in (0.2, 0.8, 0.5, 0.5, 0.9, 0.1)) / 5, abs=1e-4
    )
    assert opacities.grad is not None
    assert opacities.grad[0] > 0 > opacities.grad[2]
    assert opacities.grad[1:].tolist()[2:] == [0, 0]
    assert gradcheck(entropy, [torch.tensor([0.2, 0.7], dtype=torch.float64, requires_grad=True)])


def test_level_points_of_a_sphere_and_what_poisson_makes_of_them():
    ball = on_a_sphere(4000)
    random = torch.Generator().manual_seed(0)
    sight = torch.nn.functional.normalize(torch.randn(8000, 3, generator=random, dtype=torch.float64), dim=1)
    points = level_points(ball, -0.6 * sight, sight, 0.3)
    radius = points.positions.norm(dim=1)
    assert len(radius) > 7500
    # Looking inwards, the level lies before the middle of the Gaussians, by less than three of their thickness.
    assert 0.6 < float(radius.min()) < float(radius.max()) < 0.63
    outward = torch.nn.functional.normalize(points.positions, dim=1)
    assert float((points.normals * outward).sum(dim=1).mean()) > 0.95
    mesh = poisson(points, 6)
    assert is_closed(mesh)
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - float(radius.mean())).mean() < 3e-3
    again = poisson(points, 6)
    assert np.array_equal(mesh.vertices, again.vertices)
    assert np.array_equal(mesh.faces, again.faces)
    # A line that passes by finds nothing.
    assert len(level_points(ball, torch.tensor([[2.0, 0, 0]]).double(), sight[:1], 0.3).positions) == 0


def test_an_open_mesh_is_closed_on_the_grid():
    ball = on_a_sphere(4000)
    sight = -ball.rotations[:, :, 0]
    cap = sight[:, 2] < 0.5
    mesh = poisson(level_points(ball, -0.6 * sight[cap], sight[cap], 0.3), 6)
    assert not is_closed(mesh)
    grid = grid_over_box(torch.ones(3), 40)
    surface = closed_surface(mesh, grid, MarchingTetrahedraConfig(), CPU)
    vertices = surface.vertices.double().numpy()
    assert is_closed(Mesh(vertices=vertices, faces=surface.faces.numpy()))
    above = vertices[:, 2] > -0.1
    assert np.abs(np.linalg.norm(vertices[above], axis=1) - 0.615).max() < 0.5 * grid.cell


class Wall(Drawing):
    """Shows a wall far behind all Gaussians."""

    def draw(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        alpha = torch.ones(camera.height, camera.width, dtype=torch.float64)
        return Rendering(rgb=torch.zeros(camera.height, camera.width, 3), alpha=alpha, depth=20 * alpha)

    def terms(self, gaussians: Gaussians, lesson: Lesson) -> Terms:
        return {}


def test_without_points_there_is_no_surface():
    mesher = PoissonMesher(config(), grid_over_box(torch.ones(3), 16), CPU)
    with pytest.raises(EmptySurfaceError, match=r"^0 points have a density of 0\.3"):
        mesher.surface(Wall(), on_a_sphere(20), [CAMERA])


def test_clear_gaussians_are_dropped_once():
    made = config()
    shares = [made.least_opacity(before, now) for before, now in ((0.0, 0.0), (0.59, 0.599), (0.599, 0.6), (0.6, 0.61))]
    assert shares == [0, 0, 0.5, 0]
    some = Splats.at_random(torch.ones(3), 4, 1, GaussianRates(), torch.Generator().manual_seed(0))
    with torch.no_grad():
        some.parameters["logits"][:] = torch.tensor([1.0, -1.0, 0.0, -5.0])
    left = some.without_clear(0.5)
    assert torch.equal(left.means.detach(), some.means.detach()[[0, 2]])
    with pytest.raises(EmptySurfaceError, match="no Gaussian"):
        some.without_clear(0.9)


def test_the_missing_library_is_named_at_the_start(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ComponentImportError, match=r"the mesh of sugar needs pycolmap .*gaussian-sculpting\[pose\]"):
        sculpt.Session(small_scene(), replace(config(), gaussians=50, mesh_cells=16))


@pytest.mark.slow
def test_it_learns():
    made = config()
    small = replace(
        made, steps=200, gaussians=600, mesh_cells=32, samples=256, clear=0.2,
        poisson=PoissonConfig(points=4000, depth=5), density=replace(made.density, every=10),
    )  # fmt: skip
    session = sculpt.Session(small_scene(), replace(small, holdout_every=4))
    first = beginning_of(session)
    session.run()
    assert session.curve[-1]["psnr"] > first["psnr"] + 4
    assert session.mesh().to_trimesh().is_watertight
