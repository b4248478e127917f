"""The bending term: what it costs, which way it pulls, and where it says nothing."""

import math

import numpy as np
import pytest
import torch
import trimesh

from sculpt_framework.extractors import Extraction
from sculpt_framework.geometry.grid import grid_over_box
from sculpt_framework.types import Surface
from sculpt_plugins.losses.bending.config import BendingConfig

GRID = grid_over_box(torch.ones(3), cells=8)


def extraction(vertices: torch.Tensor, faces: np.ndarray) -> Extraction:
    """Of a surface alone: the term looks at nothing else."""
    nothing = vertices.new_zeros((0, 3))
    surface = Surface(vertices=vertices, faces=torch.from_numpy(faces).long(), face_keys=torch.arange(len(faces)))
    return Extraction(
        surface=surface,
        grid=GRID,
        cells=torch.zeros(0, dtype=torch.int64),
        cell_corners=torch.zeros((0, 8), dtype=torch.int64),
        corner_positions=nothing,
        corner_sdf=nothing[:, 0],
        edge_sdf=nothing[:, :2],
        deviation=nothing[:, 0],
        cell_weights=None,
    )


def two_faces(degrees: float) -> tuple[torch.Tensor, np.ndarray]:
    """Large triangles on both sides of an edge, the second turned up by an angle."""
    turn = math.radians(degrees)
    vertices = [[0.0, -50, 0], [0, 50, 0], [-80, 0, 0], [80 * math.cos(turn), 0, 80 * math.sin(turn)]]
    return torch.tensor(vertices, dtype=torch.float64), np.array([[0, 1, 2], [1, 0, 3]])


@pytest.mark.parametrize(("degrees", "cost"), [(0.0, 0.0), (30.0, 0.5), (180.0, 4 / (4 + 0.26795))])
def test_an_edge_costs_by_its_angle(degrees: float, cost: float):
    vertices, faces = two_faces(degrees)
    assert float(BendingConfig(crease=30.0).build()(extraction(vertices, faces))) == pytest.approx(cost, abs=1e-4)


def test_it_pulls_less_at_a_crease_than_at_a_dent():
    pulls = []
    for degrees in (15.0, 90.0):
        vertices, faces = two_faces(degrees)
        vertices.requires_grad_()
        BendingConfig().build()(extraction(vertices, faces)).backward()
        assert vertices.grad is not None
        pulls.append(float(vertices.grad.norm()))
    assert pulls[0] > 4 * pulls[1]


def test_gradient_by_finite_differences():
    """The share that a face's area gives it is no part of the derivative: faces here are large beside a cell."""
    ball = trimesh.creation.icosphere(subdivisions=1, radius=100.0)
    generator = torch.Generator().manual_seed(0)
    vertices = torch.from_numpy(np.array(ball.vertices))
    vertices = (vertices + 5 * torch.randn(vertices.shape, generator=generator, dtype=torch.float64)).requires_grad_()
    faces = np.array(ball.faces, np.int64)
    term = BendingConfig().build()
    assert torch.autograd.gradcheck(lambda moved: term(extraction(moved, faces)), (vertices,), atol=1e-6, rtol=1e-3)


def test_noise_on_a_plate_is_smoothed_and_its_rim_kept():
    box = trimesh.creation.box((1.6, 1.6, 0.4)).subdivide().subdivide().subdivide().subdivide()
    vertices, faces = torch.from_numpy(np.array(box.vertices)), np.array(box.faces, np.int64)
    top = (vertices[:, 2] > 0.19) & (vertices[:, :2].abs().amax(dim=1) < 0.79)
    rim = vertices[:, :2].abs().amin(dim=1) > 0.79
    noisy = vertices.clone()
    noisy[top, 2] += 0.01 * torch.randn(int(top.sum()), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    moved = noisy.clone().requires_grad_()
    term, optimizer = BendingConfig().build(), torch.optim.Adam([moved], lr=2e-3)
    for _ in range(60):
        optimizer.zero_grad()
        term(extraction(moved, faces)).backward()
        optimizer.step()
    still = moved.detach()
    assert float((still[top, 2] - still[top, 2].mean()).std()) < 0.5 * float((noisy[top, 2] - 0.2).std())
    assert float((still[rim] - vertices[rim]).norm(dim=1).max()) < 0.03


def test_faces_without_area_and_edges_with_one_face_cost_nothing():
    vertices, faces = two_faces(40.0)
    flat = vertices.clone()
    flat[3] = 0.5 * (flat[0] + flat[1])
    flat.requires_grad_()
    value = BendingConfig().build()(extraction(flat, faces))
    value.backward()
    assert float(value.detach()) == 0
    assert flat.grad is not None
    assert torch.isfinite(flat.grad).all()
    alone = BendingConfig().build()(extraction(vertices, faces[:1]))
    assert float(alone) == 0


def test_its_gradient_is_the_same_to_the_bit_each_time():
    ball = trimesh.creation.icosphere(subdivisions=6, radius=1.0)
    noise = 0.01 * torch.randn((len(ball.vertices), 3), generator=torch.Generator().manual_seed(0))
    vertices, faces = torch.from_numpy(np.array(ball.vertices)).float() + noise, np.array(ball.faces, np.int64)
    term, found = BendingConfig().build(), []
    for _ in range(5):
        leaf = vertices.clone().requires_grad_()
        term(extraction(leaf, faces)).backward()
        assert leaf.grad is not None
        found.append(leaf.grad)
    assert all(torch.equal(gradient, found[0]) for gradient in found)
