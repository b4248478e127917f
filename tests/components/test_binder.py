import math

import pytest
import torch

from sculpt_framework.types import Surface
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.binders.face_barycentric.placement import MAX_PER_FACE, placement


def triangle_surface(corners: torch.Tensor) -> Surface:
    """Triangles "f 3 3" that share nothing."""
    count = corners.shape[0]
    faces = torch.arange(3 * count).reshape(count, 3)
    return Surface(vertices=corners.reshape(-1, 3), faces=faces, face_keys=torch.arange(count))


def some_triangles(count: int = 4) -> torch.Tensor:
    return torch.randn(count, 3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def rows_of(binder, surface):
    return binder.new_rows(surface.faces.shape[0], surface.vertices.device, surface.vertices.dtype)


def covariance(binding):
    factor = binding.rotations * binding.scales[:, :, None]
    return factor @ factor.transpose(2, 3)


@pytest.mark.parametrize("k", range(1, MAX_PER_FACE + 1))
def test_placements_are_distinct_barycentric_coordinates(k):
    points = placement(k)
    assert points.shape == (k, 3)
    assert (points > 0).all()
    torch.testing.assert_close(points.sum(1), torch.ones(k, dtype=torch.float64))
    assert (torch.pdist(points) > 0.05).all() if k > 1 else True


@pytest.mark.parametrize("k", [0, MAX_PER_FACE + 1])
def test_placement_refuses_other_counts(k):
    with pytest.raises(ValueError, match="1 to 12"):
        placement(k)


@pytest.mark.parametrize("k", [1, 3])
@pytest.mark.parametrize("reference", ["steiner", "edges"])
def test_gaussians_lie_in_the_plane_of_their_face(k, reference):
    surface = triangle_surface(some_triangles())
    binder = FaceBarycentricConfig(
        gaussians_per_face=k, reference=reference, normal_scale=1e-6, fit_outline=False
    ).build()
    binding = binder.bind(surface, rows_of(binder, surface), blur=0.0)
    corners = surface.vertices[surface.faces]
    normal = torch.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], dim=1)
    normal = normal / normal.norm(dim=1, keepdim=True)
    torch.testing.assert_close(binding.rotations[:, :, :, 0], normal[:, None].expand(-1, k, -1))
    offset = ((binding.means - corners[:, None, 0]) * normal[:, None]).sum(2)
    torch.testing.assert_close(offset, torch.zeros_like(offset), atol=1e-12, rtol=0)
    thickness = torch.einsum("fi,fkij,fj->fk", normal, covariance(binding), normal)
    torch.testing.assert_close(thickness, torch.full_like(thickness, 1e-12), rtol=1e-3, atol=1e-14)
    torch.testing.assert_close(binding.barycentrics.sum(2), torch.ones_like(offset))


def test_edges_reference_is_the_paper_s_equation():
    surface = triangle_surface(some_triangles())
    binder = FaceBarycentricConfig(reference="edges", scale=1.0, rotation_rate=0.0, fit_outline=False).build()
    binding = binder.bind(surface, rows_of(binder, surface), blur=0.0)
    corners = surface.vertices[surface.faces]
    torch.testing.assert_close(binding.scales[:, 0, 1], 0.5 * (corners[:, 1] - corners[:, 0]).norm(dim=1))
    torch.testing.assert_close(binding.scales[:, 0, 2], 0.5 * (corners[:, 2] - corners[:, 0]).norm(dim=1))
    r1, r2 = binding.rotations[:, 0, :, 1], binding.rotations[:, 0, :, 2]
    torch.testing.assert_close((r1 * r2).sum(1), torch.zeros(4, dtype=torch.float64), atol=1e-12, rtol=0)


def test_steiner_covariance_does_not_depend_on_the_order_of_vertices():
    corners = some_triangles()
    binder = FaceBarycentricConfig(scale=1.0, normal_scale=1e-6, fit_outline=False).build()
    first, second = (triangle_surface(corners[:, order]) for order in ([0, 1, 2], [1, 2, 0]))
    one, other = (covariance(binder.bind(s, rows_of(binder, s), blur=0.0)) for s in (first, second))
    torch.testing.assert_close(one, other)
    # Unit ratios: the ellipse x^T M^-1 x = 1 passes through the corners, so M has trace (2/3) sum |v - c|^2.
    centred = corners - corners.mean(1, keepdim=True)
    expected = (2 / 3) * centred.square().sum((1, 2))
    torch.testing.assert_close(one[:, 0].diagonal(dim1=1, dim2=2).sum(1), expected, rtol=1e-6, atol=1e-9)


def test_tangent_covariance_is_the_covariance_in_the_face_frame():
    surface = triangle_surface(some_triangles())
    binder = FaceBarycentricConfig(gaussians_per_face=2).build()
    rows = rows_of(binder, surface)
    rows["rotation"] = torch.full_like(rows["rotation"], 0.4)
    rows["log_ratios"] = rows["log_ratios"] + torch.tensor([0.3, -0.5], dtype=torch.float64)
    binding = binder.bind(surface, rows, blur=0.0)
    full = covariance(binding)
    flat = binding.tangent_covariance
    # Same trace and determinant once the thickness along the normal is taken off.
    trace = full.diagonal(dim1=2, dim2=3).sum(2) - binding.scales[:, :, 0] ** 2
    torch.testing.assert_close(flat.diagonal(dim1=2, dim2=3).sum(2), trace, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(torch.linalg.det(full) / binding.scales[:, :, 0] ** 2, torch.linalg.det(flat))


def test_gaussians_of_a_face_share_the_area_of_the_steiner_ellipse():
    surface = triangle_surface(some_triangles())
    areas = []
    for k in (1, 4):
        binder = FaceBarycentricConfig(gaussians_per_face=k, fit_outline=False).build()
        binding = binder.bind(surface, rows_of(binder, surface), blur=0.0)
        areas.append(torch.linalg.det(binding.tangent_covariance).sqrt().sum(dim=1))
    torch.testing.assert_close(areas[0], areas[1])


@pytest.mark.parametrize("reference", ["steiner", "edges"])
@pytest.mark.parametrize("opacity", ["fixed", "learnable"])
def test_gradients(reference, opacity):
    # The fit is a constant of the step (test_splat_surface.py): differences would see it change.
    binder = FaceBarycentricConfig(
        gaussians_per_face=2, reference=reference, opacity=opacity, fit_outline=False
    ).build()
    corners = some_triangles(2).requires_grad_()
    rows = rows_of(binder, triangle_surface(corners))
    names = list(rows)
    values = [(rows[name] + 0.1).requires_grad_() for name in names]

    def outputs(corners, *values):
        binding = binder.bind(triangle_surface(corners), dict(zip(names, values, strict=True)), blur=0.01)
        return (
            binding.means,
            binding.scales,
            binding.rotations,
            binding.opacities,
            binding.tangent_covariance,
            binding.tangent_corners,
        )

    assert torch.autograd.gradcheck(outputs, (corners, *values))


@pytest.mark.parametrize(
    "corners",
    [
        [[0.0, 0, 0], [0, 0, 0], [0, 0, 0]],
        [[0.0, 0, 0], [1, 0, 0], [1, 0, 0]],
        [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [[0.0, 0, 0], [1, 0, 0], [0.5, 1e-8, 0]],
        [[1e5, 0, 0], [1e5, 1e-6, 0], [1e5, 0, 1e-6]],
    ],
)
@pytest.mark.parametrize("reference", ["steiner", "edges"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("blur", [0.0, 0.01])
def test_degenerate_faces_bind_finite_gaussians_with_finite_gradients(corners, reference, dtype, blur):
    corners = torch.tensor([corners], dtype=dtype, requires_grad=True)
    binder = FaceBarycentricConfig(gaussians_per_face=3, reference=reference).build()
    surface = triangle_surface(corners)
    binding = binder.bind(surface, rows_of(binder, surface), blur=blur)
    total = sum(
        value.sum()
        for value in (binding.means, binding.scales, binding.rotations, binding.tangent_covariance, binding.opacities)
    )
    assert math.isfinite(float(total.detach()))
    total.backward()
    assert corners.grad is not None
    assert torch.isfinite(corners.grad).all()
