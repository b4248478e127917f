"""What a field says of Gaussians and they of it: known answers, gradients, what is said at their limits."""

import json
import math
from dataclasses import replace

import pytest
import torch
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.errors import ConfigError
from sculpt_framework.free_gaussians.config import DensityConfig, GaussianRates
from sculpt_framework.free_gaussians.drawing import facing
from sculpt_framework.free_gaussians.splats import Splats, Worth
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.guided_gaussians.config import AgreementConfig, GuidedGaussiansConfig
from sculpt_framework.guided_gaussians.guide import Guide, RayLesson, Shown, cosine, mean_of
from sculpt_framework.serialization import config_from_json, config_to_json
from sculpt_framework.types import Camera, Gaussians
from sculpt_framework.validation import check
from sculpt_framework.volume_rendering.pixels import rays_at
from sculpt_framework.volume_rendering.stretches import OccupiedCells
from sculpt_plugins.methods.gaussians_3dgsr.config import Gaussians3dgsrConfig
from sculpt_plugins.methods.gaussians_3dgsr.guide import bell
from sculpt_plugins.methods.gsdf.config import GsdfConfig
from sculpt_plugins.methods.gsdf.guide import nearness

RADIUS = 0.5
"""Of the sphere that a field starts as."""
FULL = OccupiedCells(occupied=torch.ones(4, 4, 4, dtype=torch.bool), low=(-1.0, -1.0, -1.0), cell=0.5)
AHEAD = Camera(
    world_to_camera=torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]),
    fx=60.0, fy=60.0, cx=16.0, cy=16.0, width=32, height=32,
)  # fmt: skip


def guide(name: str) -> Guide:
    config = sculpt.methods[name]()
    assert isinstance(config, GuidedGaussiansConfig)
    if isinstance(config, GsdfConfig):
        radiance = replace(config.radiance, num_levels=2, log2_table=10, finest_resolution=16, hidden_units=16)
        config = replace(config, radiance=radiance)
    torch.manual_seed(0)
    agreement = AgreementConfig(depth=1.0, normal=1.0)
    rays = replace(config.rays, sharpness=300.0)
    return replace(config, rays=rays, agreement=agreement).build_guide()


def sphere_seen(radius: float, cover: float = 1.0) -> RayLesson:
    """Of every pixel: depth and normal of a ball around the origin, drawn with this opacity."""
    rays = rays_at(AHEAD, torch.arange(AHEAD.width * AHEAD.height))
    middle = -(rays.origins * rays.directions).sum(dim=1)
    left = radius**2 - rays.origins.square().sum(dim=1) + middle.square()
    hit = left > 0
    depth = torch.where(hit, middle - left.clamp(min=0).sqrt(), 0.0)
    normal = torch.where(hit[:, None], (rays.origins + depth[:, None] * rays.directions) / radius, 0.0)
    alpha = cover * hit.float()
    shown = Shown(rays=rays, alpha=alpha, depth=alpha * depth, normal=alpha[:, None] * normal)
    return RayLesson(
        shown=shown,
        premultiplied=torch.zeros(len(rays), 3),
        alpha=hit.float(),
        background=torch.zeros(3),
        cells=FULL,
        generator=torch.Generator().manual_seed(0),
    )


def gaussians_at(means: list[list[float]]) -> Gaussians:
    some = Splats.at_random(torch.ones(3), max(4, len(means)), 0, GaussianRates(), torch.Generator().manual_seed(0))
    every = some.gaussians(1)
    count = len(means)
    return Gaussians(
        means=torch.tensor(means), scales=every.scales[:count], rotations=every.rotations[:count],
        opacities=torch.full((count,), 0.08), sh=every.sh[:count], face=every.face[:count],
    )  # fmt: skip


# -- 3DGSR ---------------------------------------------------------------------------------------------------------


def test_the_bell_is_one_at_the_surface_and_as_wide_as_beta_says():
    beta = torch.tensor(8.0, dtype=torch.float64)
    half = 2 * math.acosh(math.sqrt(2)) / 8
    found = bell(torch.tensor([0.0, half, -half, 1e4, -1e4], dtype=torch.float64), beta)
    assert found.tolist() == pytest.approx([1, 0.5, 0.5, 0, 0])
    # It is the logistic density, scaled to 1 at 0.
    sdf = torch.linspace(-1, 1, 9, dtype=torch.float64)
    logistic = torch.sigmoid(beta * sdf)
    assert torch.allclose(bell(sdf, beta), 4 * logistic * (1 - logistic))


def test_the_bells_slopes_are_right_and_finite_far_away():
    sdf = torch.tensor([0.05, -0.02, 0.3, -0.4], dtype=torch.float64, requires_grad=True)
    beta = torch.tensor(12.0, dtype=torch.float64, requires_grad=True)
    assert gradcheck(bell, (sdf, beta))
    far = torch.tensor([1e4, -1e4, 0.0], requires_grad=True)
    bell(far, torch.tensor(50.0)).sum().backward()
    assert far.grad is not None
    assert far.grad.tolist() == [0, 0, 0]


def test_opacities_are_the_fields_and_teach_it():
    own = guide("3dgsr")
    given = gaussians_at([[RADIUS, 0, 0], [0.0, 0.9, 0], [0.1, 0, 0]])
    guided = own.guided(given)
    assert guided.opacities.tolist() == pytest.approx([1 / math.cosh(5 * s) ** 2 for s in (0, 0.4, 0.4)], rel=1e-3)
    assert own.worth(given).opacities.tolist() == guided.opacities.tolist()
    guided.opacities.sum().backward()
    assert any(each.grad is not None and each.grad.abs().max() > 0 for each in own.volume.field.parameters())


def test_what_opacities_do_not_go_by_is_not_there_or_refused():
    config = sculpt.methods["3dgsr"]()
    assert isinstance(config, Gaussians3dgsrConfig)
    assert not any("radiance" in name for name in config.build_guide().state_dict())
    # The options that are gone were in config.json at these values.
    before = json.loads(config_to_json(config))
    radiance = json.loads(config_to_json(sculpt.methods["gsdf"]()))["radiance"]
    assert config_from_json(json.dumps({**before, "field_from": 0.0, "radiance": radiance})) == config
    with pytest.raises(ConfigError, match=r"^field_from is 0\.5; the option is gone"):
        config_from_json(json.dumps({**before, "field_from": 0.5}))
    check(config)
    check(sculpt.methods["3dgsr-paper"]())
    with pytest.raises(ConfigError, match=r"^--density\.reset-every is 9; expected 0, as opacities follow the field"):
        check(replace(config, density=replace(config.density, reset_every=9)))
    with pytest.raises(ConfigError, match=r"^--rates\.opacities is 0\.1; expected 0\.05, as opacities follow"):
        check(replace(config, rates=replace(config.rates, opacities=0.1)))


# -- GSDF ----------------------------------------------------------------------------------------------------------


def test_nearness():
    sdf = torch.tensor([0.0, 0.1, -0.1, 1e3], dtype=torch.float64, requires_grad=True)
    found = nearness(sdf, 0.1)
    assert found.tolist() == pytest.approx([1, math.exp(-0.5), math.exp(-0.5), 0])
    assert gradcheck(lambda given: nearness(given, 0.1), (sdf.detach()[:3].requires_grad_(),))


def test_gaussians_grow_at_the_surface_and_go_where_they_are_far_from_it():
    own = guide("gsdf")
    worth = own.worth(gaussians_at([[0, 0, RADIUS], [0.0, 0.9, 0.9]]))
    assert worth.opacities.tolist() == pytest.approx([0.08, 0.08 - 0.1], abs=1e-6)
    assert worth.pull.tolist() == pytest.approx([5e-5, 0], abs=1e-9)


def test_what_is_said_of_gaussians_decides_of_their_number():
    some = Splats.at_random(torch.ones(3), 4, 0, GaussianRates(), torch.Generator().manual_seed(0))
    density = DensityConfig(gradient=1.0, large=100.0, least_opacity=0.01)
    some.pull, some.shown = torch.full((4,), 0.6), torch.ones(4)
    before = some.means.detach().clone()

    def said(gaussians: Gaussians) -> Worth:
        assert len(gaussians) == 4
        return Worth(opacities=torch.tensor([0.5, 0.0, 0.5, -1.0]), pull=torch.tensor([0.0, 0.9, 0.5, 0.9]))

    # The second and the fourth are dropped, however they are pulled at; the third is cloned.
    after = some.renewed(density, torch.Generator(), said)
    assert torch.equal(after.means.detach(), before[[0, 2, 2]])
    with pytest.raises(EmptySurfaceError, match="no Gaussian"):
        some.renewed(density, torch.Generator(), lambda of: Worth(opacities=-torch.ones(4), pull=torch.zeros(4)))


def test_rays_are_looked_at_around_the_depths_that_gaussians_show():
    own, lesson = guide("gsdf"), sphere_seen(RADIUS + 0.1)
    stretches, shown = own.stretches(lesson), lesson.shown
    covered = shown.covered
    counts = stretches.offsets.diff()
    assert (counts[covered] == 24).all()
    # Where nothing is, an even march across the box.
    through_the_box = counts[~covered] > 0
    assert through_the_box.any()
    ray = int(covered.nonzero()[0, 0])
    part = slice(int(stretches.offsets[ray]), int(stretches.offsets[ray + 1]))
    begin, length = stretches.begin[part], stretches.length[part]
    # The field has the distance 0.1 there: 0.4 in front and 0.4 behind, moved on by half a stretch at most.
    assert float(length.sum()) == pytest.approx(0.8, rel=1e-3)
    assert float(begin[0]) == pytest.approx(float(shown.mean_depth[ray]) - 0.4, abs=float(length[0]))
    assert stretches.goes_on[part].tolist() == [True] * 23 + [False]


# -- both ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["3dgsr", "gsdf"])
def test_a_sphere_drawn_as_the_field_has_it_agrees_and_another_does_not(name: str):
    own = guide(name)
    inner, outer, far = sphere_seen(RADIUS), sphere_seen(RADIUS + 0.06), sphere_seen(RADIUS + 0.2)
    same, other = own.terms(inner), own.terms(outer)
    apart = (inner.shown.depth - outer.shown.depth)[inner.shown.covered]
    # Beside the outline slanted rays meet the spheres far apart, which teaches nothing.
    apart = torch.where(apart < 0.1, apart, 0.0).mean()
    assert float(same["depth"].detach()) < 0.004
    assert float(same["normal"].detach()) < 0.01
    assert float(other["depth"].detach()) == pytest.approx(float(apart), abs=0.004)
    assert float(other["mask"].detach()) > float(same["mask"].detach())
    assert float(own.terms(far)["depth"].detach()) == 0


def test_where_nothing_is_covered_there_is_nothing_to_agree_on():
    own = guide("3dgsr")
    lesson = sphere_seen(RADIUS, cover=0.2)
    terms = own.terms(lesson)
    assert float(terms["depth"].detach()) == 0
    assert float(terms["normal"].detach()) == 0
    (terms["depth"] + terms["normal"]).backward()
    assert all(torch.isfinite(each.grad).all() for each in own.parameters() if each.grad is not None)


def test_both_learn_from_disagreement():
    own = guide("3dgsr")
    lesson = sphere_seen(RADIUS + 0.1)
    depth = lesson.shown.depth.clone().requires_grad_()
    normal = (lesson.shown.normal + torch.tensor([0.2, 0.0, 0.1])).requires_grad_()
    terms = own.terms(replace(lesson, shown=replace(lesson.shown, depth=depth, normal=normal)))
    (terms["depth"] + terms["normal"]).backward()
    assert depth.grad is not None
    assert normal.grad is not None
    # The ball is drawn too near: its depths should grow.
    assert (depth.grad <= 0).all()
    assert float(depth.grad.min()) < 0
    assert float(normal.grad.abs().max()) > 0
    assert any(each.grad is not None and each.grad.abs().max() > 0 for each in own.volume.field.parameters())


def test_means_and_cosines_at_their_limits():
    total = torch.tensor([2.0, 0.0, 1.0], dtype=torch.float64, requires_grad=True)
    alpha = torch.tensor([0.5, 0.0, 0.8], dtype=torch.float64, requires_grad=True)
    covered = torch.tensor([True, False, True])
    found = mean_of(total, alpha, covered)
    assert found.tolist() == pytest.approx([4, 0, 1.25])
    assert gradcheck(lambda one, two: mean_of(one, two, covered), (total, alpha))
    first = torch.tensor([[1.0, 0, 0], [0, 2, 0], [0, 0, 0]], dtype=torch.float64, requires_grad=True)
    second = torch.tensor([[3.0, 3, 0], [0, -1, 0], [1, 0, 0]], dtype=torch.float64, requires_grad=True)
    cosines = cosine(first, second)
    assert cosines.tolist() == pytest.approx([math.sqrt(0.5), -1, 0])
    cosines.sum().backward()
    assert first.grad is not None
    assert first.grad[2].tolist() == [0, 0, 0]
    assert gradcheck(cosine, (first.detach()[:2].requires_grad_(), second.detach()[:2].requires_grad_()))


def test_normals_face_the_camera():
    normals = torch.tensor([[0.0, 0, 1], [0, 0, -1]])
    assert torch.equal(facing(normals, torch.zeros(2, 3), AHEAD), torch.tensor([[0.0, 0, -1], [0, 0, -1]]))
