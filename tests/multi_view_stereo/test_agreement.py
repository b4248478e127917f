"""Photographs laid into each other through a mesh: known answers, the gradient, and what cannot be compared."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.losses import TrainingImage
from sculpt_framework.multi_view_stereo.agreement import Disagreement, Photograph, disagreement, look_at
from sculpt_framework.types import Camera, Surface
from sculpt_plugins.losses.consistency.config import ConsistencyConfig

RADIUS, DISTANCE, SIDE = 0.8, 3.0, 120
SLACK = 0.05


def camera(angle: float) -> Camera:
    """On a circle around the origin, which it looks at."""
    cosine, sine = np.cos(angle), np.sin(angle)
    pose = torch.tensor([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, DISTANCE], [0, 0, 0, 1]])
    middle = SIDE / 2
    return Camera(
        world_to_camera=pose.double(), fx=1.6 * SIDE, fy=1.6 * SIDE, cx=middle, cy=middle, width=SIDE, height=SIDE
    )


def pattern(points: np.ndarray) -> np.ndarray:
    waves = np.random.default_rng(3).normal(size=(3, 30)) * np.geomspace(6, 30, 30)
    return np.clip(0.5 + 0.05 * np.sin(points @ waves + np.arange(30)).sum(axis=-1), 0, 1)


def photograph(angle: float) -> Photograph:
    """A ball in a pattern, by intersecting each pixel's ray with it."""
    at = camera(angle)
    pose = at.world_to_camera.double().numpy()
    columns, rows = np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5)
    rays = np.stack([(columns - at.cx) / at.fx, (rows - at.cy) / at.fy, np.ones_like(rows)], axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    along = rays @ pose[:3, 3]
    beside = pose[:3, 3] @ pose[:3, 3] - along**2
    inside = beside < RADIUS**2
    near = along - np.sqrt(np.maximum(RADIUS**2 - beside, 0))
    world = (rays * near[..., None] - pose[:3, 3]) @ pose[:3, :3]
    return Photograph(camera=at, luminance=np.where(inside, pattern(world), 0), usable=inside)


@pytest.fixture(scope="module")
def pair() -> tuple[Photograph, Photograph]:
    return photograph(0.0), photograph(0.25)


def ball(radius: float = RADIUS) -> tuple[np.ndarray, np.ndarray]:
    shape = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return np.array(shape.vertices), np.array(shape.faces, np.int64)


def compare(
    pair: tuple[Photograph, Photograph], vertices: np.ndarray, faces: np.ndarray, window: int = 7
) -> Disagreement:
    first, second = (look_at(each, vertices, faces) for each in pair)
    return disagreement(first, second, faces, window, SLACK)


def test_photographs_agree_on_the_true_surface_alone(pair: tuple[Photograph, Photograph]):
    totals = {}
    for scale in (0.97, 0.99, 1.0, 1.01, 1.03):
        found = compare(pair, *ball(scale * RADIUS))
        totals[scale] = found.total / found.judged
    assert totals[1.0] < 0.01
    assert totals[0.97] > totals[0.99] > 2 * totals[1.0]
    assert totals[1.03] > totals[1.01] > 2 * totals[1.0]


@pytest.mark.parametrize("scale", [0.985, 1.015])
def test_the_gradient_leads_to_the_true_surface(pair: tuple[Photograph, Photograph], scale: float):
    vertices, faces = ball(scale * RADIUS)
    outward = (compare(pair, vertices, faces).gradient * vertices).sum()
    assert outward * (scale - 1) > 0


def test_gradient_by_finite_differences(pair: tuple[Photograph, Photograph]):
    """Along smooth motions, of which almost none moves a pixel to where it cannot be compared."""
    vertices, faces = ball(0.99 * RADIUS)
    gradient = compare(pair, vertices, faces).gradient
    generator = np.random.default_rng(0)
    for _ in range(4):
        way = np.sin(vertices @ generator.normal(size=(3, 3)) * 2 + generator.uniform(0, 6, 3))
        # Where both cameras look straight on, so that the outline stays where it is.
        way *= np.exp(-(((vertices - [0.1, 0, -RADIUS]) / 0.3) ** 2).sum(axis=1))[:, None]
        step = 1e-5
        rise = compare(pair, vertices + step * way, faces).total - compare(pair, vertices - step * way, faces).total
        assert (gradient * way).sum() == pytest.approx(rise / (2 * step), rel=2e-3)


def test_gain_and_offset_change_nothing(pair: tuple[Photograph, Photograph]):
    vertices, faces = ball(0.99 * RADIUS)
    plain = compare(pair, vertices, faces)
    darker = replace(pair[1], luminance=0.6 * pair[1].luminance + 0.2)
    other = compare((pair[0], darker), vertices, faces).gradient
    # But for windows of little contrast, which come nearer to the noise.
    assert (other * plain.gradient).sum() > 0.98 * np.linalg.norm(other) * np.linalg.norm(plain.gradient)


def test_nothing_is_said_of_what_cannot_be_compared(pair: tuple[Photograph, Photograph]):
    vertices, faces = ball()
    plain = replace(pair[0], luminance=np.full((SIDE, SIDE), 0.5))
    saturated = replace(pair[1], usable=np.zeros((SIDE, SIDE), bool))
    behind = photograph(np.pi)
    for others in ((plain, pair[1]), (pair[0], saturated), (pair[0], behind)):
        found = compare(others, vertices, faces)
        assert found.judged == 0
        assert found.total == 0
        assert not found.gradient.any()


def test_a_highlight_moves_nothing(pair: tuple[Photograph, Photograph]):
    """Where one photograph shows something else, the surface must stay."""
    vertices, faces = ball()
    rows, columns = np.mgrid[:SIDE, :SIDE]
    noise = np.random.default_rng(5).uniform(0, 1, (SIDE, SIDE))
    square = (abs(rows - SIDE / 2) < 12) & (abs(columns - SIDE / 2) < 12)
    disturbed = compare(
        (pair[0], replace(pair[1], luminance=np.where(square, noise, pair[1].luminance))), vertices, faces
    )
    blind = replace(pair[1], usable=pair[1].usable & ~square)
    undisturbed = compare((pair[0], blind), vertices, faces)
    assert disturbed.total > undisturbed.total + 10
    moved = np.linalg.norm(disturbed.gradient, axis=1).sum()
    off = np.linalg.norm(compare(pair, *ball(0.99 * RADIUS)).gradient, axis=1).sum()
    assert moved < 0.6 * off


def test_single_precision_is_the_double_one(pair: tuple[Photograph, Photograph]):
    vertices, faces = ball(0.99 * RADIUS)
    exact = compare(pair, vertices, faces)
    single = compare(
        tuple(replace(each, luminance=each.luminance.astype(np.float32)) for each in pair),  # pyright: ignore[reportArgumentType]
        vertices,
        faces,
    )
    assert single.total == pytest.approx(exact.total, rel=1e-4)
    assert np.linalg.norm(single.gradient - exact.gradient) < 1e-3 * np.linalg.norm(exact.gradient)


def images(count: int, masked: bool = True) -> list[TrainingImage]:
    made = []
    for number in range(count):
        view = photograph(0.2 * number)
        rgb = torch.from_numpy(view.luminance).float()[..., None].expand(-1, -1, 3)
        alpha = torch.from_numpy(view.usable).float() if masked else None
        made.append(TrainingImage(name=str(number), camera=view.camera, premultiplied=rgb, alpha=alpha))
    return made


def surface(radius: float) -> Surface:
    vertices, faces = ball(radius)
    return Surface(
        vertices=torch.from_numpy(vertices).float().requires_grad_(),
        faces=torch.from_numpy(faces),
        face_keys=torch.arange(len(faces)),
    )


def test_descent_mends_a_ball():
    """A ball 2 % too small, whose vertices follow the term: where views see it, it comes back to its size."""
    term = ConsistencyConfig(views=3).build()
    term.begin(images(6))
    shape = surface(0.98 * RADIUS)
    optimizer = torch.optim.Adam([shape.vertices], lr=1e-3)
    for step in range(40):
        optimizer.zero_grad()
        term(shape, [step % 6, (step + 2) % 6, (step + 4) % 6], step).backward()
        # Vertices on their own would crumple: neighbours move together.
        assert shape.vertices.grad is not None
        shape.vertices.grad = smoothed(shape, shape.vertices.grad)
        optimizer.step()
    seen = shape.vertices.detach()
    ahead = seen @ torch.tensor([np.sin(-0.5), 0, -np.cos(-0.5)], dtype=torch.float32)
    front = seen[ahead > 0.7 * RADIUS]
    assert float((front.norm(dim=1) - RADIUS).abs().mean()) < 0.004


def smoothed(shape: Surface, values: torch.Tensor) -> torch.Tensor:
    for _ in range(10):
        total, count = torch.zeros_like(values), torch.zeros(len(values), 1)
        mean = values[shape.faces].mean(dim=1)
        for corner in range(3):
            total.index_add_(0, shape.faces[:, corner], mean)
            count.index_add_(0, shape.faces[:, corner], torch.ones(len(mean), 1))
        values = total / count
    return values


def test_the_same_views_mean_the_same_pairs():
    term, again = ConsistencyConfig().build(), ConsistencyConfig().build()
    for each in (term, again):
        each.begin(images(6))
    shape = surface(0.97 * RADIUS)
    term(shape, [0], 0)
    assert torch.equal(term(shape, [1, 3], 5).detach(), again(shape, [1, 3], 5).detach())


def test_shares_of_the_views_add_up():
    """As processes divide them: to the same value and gradient."""
    term = ConsistencyConfig().build()
    term.begin(images(6))
    together, apart = surface(0.98 * RADIUS), surface(0.98 * RADIUS)
    whole = term(together, [0, 2, 3], 4)
    parts = (term(apart, [0, 2], 4) * 2 + term(apart, [3], 4)) / 3
    assert float(whole.detach()) == pytest.approx(float(parts.detach()), rel=1e-6)
    whole.backward()
    parts.backward()
    assert together.vertices.grad is not None
    assert apart.vertices.grad is not None
    torch.testing.assert_close(together.vertices.grad, apart.vertices.grad, rtol=1e-4, atol=1e-7)


def test_partners_take_turns():
    term = ConsistencyConfig(partners=1).build()
    term.begin(images(6))
    shape = surface(0.98 * RADIUS)
    assert len({float(term(shape, [2], step).detach()) for step in range(3)}) == 3


def test_views_on_opposite_sides_say_nothing():
    term = ConsistencyConfig().build()
    cameras = demo_cameras(2, 64)
    given = [
        TrainingImage(name=str(n), camera=each, premultiplied=torch.rand(64, 64, 3), alpha=None)
        for n, each in enumerate(cameras)
    ]
    term.begin(given)
    value = term(surface(RADIUS), [0, 1], 0)
    assert float(value) == 0
    assert not value.requires_grad
