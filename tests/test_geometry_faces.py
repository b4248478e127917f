"""Frames, normals, areas and angles of triangles, good and bad."""

import math

import pytest
import torch

from sculpt_framework.geometry.faces import (
    face_areas,
    face_corners,
    face_normals,
    is_degenerate,
    smallest_angles,
    tangent_frame,
)

DEGENERATE = {
    "point": [[0.3, 0.2, 0.1]] * 3,
    "origin": [[0.0, 0.0, 0.0]] * 3,
    "collinear": [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [2.0, 4.0, 6.0]],
    "two-alike": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    "last-two-alike": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
    "needle": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-18, 0.0]],
    "tiny": [[0.0, 0.0, 0.0], [1e-170, 0.0, 0.0], [0.0, 1e-170, 0.0]],
    "huge-needle": [[0.0, 0.0, 0.0], [1e12, 0.0, 0.0], [1e12, 1e-9, 0.0]],
}


def random_corners(count: int = 5) -> torch.Tensor:
    return torch.randn(count, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))


def test_known_triangle():
    vertices = torch.tensor([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 3.0, 1.0]])
    corners = face_corners(vertices, torch.tensor([[0, 1, 2]]))
    assert face_areas(corners).tolist() == [3.0]
    assert face_normals(corners).tolist() == [[0.0, 0.0, 1.0]]
    assert tangent_frame(corners).tolist() == [[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]]


def test_frames_are_rotations():
    frame = tangent_frame(random_corners(50))
    torch.testing.assert_close(frame @ frame.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3))
    torch.testing.assert_close(torch.linalg.det(frame), torch.ones(50, dtype=torch.float64))


@pytest.mark.parametrize("measure", [face_areas, face_normals, tangent_frame])
def test_gradients(measure):
    assert torch.autograd.gradcheck(measure, [random_corners().requires_grad_()])


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_faces_are_finite_with_finite_gradient(name: str):
    good = random_corners(1)
    corners = torch.cat([torch.tensor([DEGENERATE[name]], dtype=torch.float64), good]).requires_grad_()
    assert is_degenerate(corners).tolist() == [True, False]
    frame, area = tangent_frame(corners), face_areas(corners)
    torch.testing.assert_close(frame[0] @ frame[0].mT, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(frame[0]) > 0
    assert area[0] == 0
    (slope,) = torch.autograd.grad((frame * random_corners(2)).sum() + area.sum(), [corners])
    assert bool((slope[0] == 0).all())
    alone = good.clone().requires_grad_()
    (expected,) = torch.autograd.grad(
        (tangent_frame(alone) * random_corners(2)[1:]).sum() + face_areas(alone).sum(), [alone]
    )
    torch.testing.assert_close(slope[1:], expected)


def test_degenerate_frame_keeps_to_the_longest_side():
    corners = torch.tensor([DEGENERATE["collinear"]], dtype=torch.float64)
    direction = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64) / math.sqrt(14)
    assert abs(float(tangent_frame(corners)[0, :, 1] @ direction)) == pytest.approx(1)


def test_thin_face_in_single_precision_has_a_frame():
    corners = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-5, 0.0]]])
    assert not is_degenerate(corners).any()
    torch.testing.assert_close(face_normals(corners), torch.tensor([[0.0, 0.0, 1.0]]))


def test_smallest_angle():
    def angle(*corners: tuple[float, float]) -> float:
        points = torch.tensor(corners, dtype=torch.float64)
        side = points.roll(-1, dims=0) - points
        doubled_area = (side[0, 0] * side[1, 1] - side[0, 1] * side[1, 0]).abs()
        return math.degrees(float(smallest_angles(side.square().sum(dim=1)[None], doubled_area[None])))

    assert angle((0, 0), (1, 0), (0.5, math.sqrt(0.75))) == pytest.approx(60)
    assert angle((0, 0), (1, 0), (0, 1)) == pytest.approx(45)
    assert angle((0, 0), (1, 0), (math.cos(1e-6), math.sin(1e-6))) == pytest.approx(math.degrees(1e-6), rel=1e-3)
    assert angle((0, 0), (0, 0), (1, 0)) == 0
    assert angle((0, 0), (1, 0), (2, 0)) == 0
