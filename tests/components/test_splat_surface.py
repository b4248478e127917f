"""The outline of the Gaussians is the outline of the mesh (docs/background/splat-surface.md)."""

import functools
import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from torch import Tensor

from sculpt_framework.evaluation.splat_outline import OutlineError
from sculpt_framework.geometry.faces import face_corners, face_normals
from sculpt_framework.testing import box_sdf, tetrahedron
from sculpt_framework.testing.splat_surface import (
    OUTLINE_SHAPES,
    new_gaussians,
    outline_cameras,
    splat_surface_offsets,
    surface_on_grid,
    turned_sdf,
)
from sculpt_framework.types import Surface
from sculpt_methods.sculpting import gaussian_sculpting
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.binders.face_barycentric.limits import LOG_LAYERS_FROM, LOG_LAYERS_STEP
from sculpt_plugins.binders.face_barycentric.outline import neighbours, rim_depths
from sculpt_plugins.binders.face_barycentric.thickness import thicknesses

METHOD = gaussian_sculpting()
MEAN_BAR, P95_BAR = 0.1, 0.3


@functools.cache
def surface(shape: str, cells: int) -> Surface:
    return surface_on_grid(METHOD.extractor, OUTLINE_SHAPES[shape], cells)


def outline_error(shape: str, cells: int, pixels: int, binder: FaceBarycentricConfig, views: int) -> OutlineError:
    rasterizer = METHOD.rasterizer.build(torch.device("cpu"))
    low_pass = METHOD.trainer.low_pass_px2
    cameras = outline_cameras(pixels, views)
    return OutlineError.of(
        splat_surface_offsets(surface(shape, cells), binder, rasterizer, cameras, low_pass_px2=low_pass)
    )


def check(shape: str, cells: int, pixels: int, per_face: int, views: int):
    binder = replace(METHOD.binder, gaussians_per_face=per_face)
    assert isinstance(binder, FaceBarycentricConfig)
    error = outline_error(shape, cells, pixels, binder, views)
    assert abs(error.mean) <= MEAN_BAR, error
    assert error.p95 <= P95_BAR, error


SOME = [(32, 100, 1), (32, 100, 6), (32, 200, 3), (64, 200, 1)]
ALL = list(product((32, 64, 128), (100, 200, 400), (1, 3, 6)))


@pytest.mark.parametrize(("cells", "pixels", "per_face"), SOME)
@pytest.mark.parametrize("shape", OUTLINE_SHAPES)
def test_outlines(shape: str, cells: int, pixels: int, per_face: int):
    check(shape, cells, pixels, per_face, views=2)


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "pixels", "per_face"), ALL)
@pytest.mark.parametrize("shape", OUTLINE_SHAPES)
def test_outlines_at_all_sizes(shape: str, cells: int, pixels: int, per_face: int):
    if (shape, cells, pixels, per_face) == ("plate", 32, 400, 1):
        pytest.xfail("one Gaussian on faces 9 pixels wide leaves dips along a sharp edge: 95 % are within 0.43 pixels")
    check(shape, cells, pixels, per_face, views=4)


def test_on_their_faces_gaussians_stand_outside():
    error = outline_error("sphere", 32, 100, FaceBarycentricConfig(fit_outline=False), views=2)
    assert error.mean > 0.3


@pytest.mark.parametrize("layers", [2.0, 8.0, 40.0])
def test_the_depth_is_where_a_rim_of_gaussians_covers_half(layers: float):
    """Against a sum over single Gaussians, spread evenly over a parabolic rim."""
    theta, curvature, spacing = 0.99, 0.02, 0.02
    depths = rim_depths(theta)
    depth = np.interp(math.log(layers), LOG_LAYERS_FROM + LOG_LAYERS_STEP * np.arange(len(depths)), depths)
    # s = 1; a row along the rim of deviation 1, rows back and forth along the line of sight.
    density = layers / math.sqrt(2.0 * math.pi) / math.sqrt(2.0 / curvature)
    along = np.arange(-6.0, 6.0, spacing)
    back = np.arange(-40.0, 40.0, 10 * spacing)
    alpha = theta * np.exp(-0.5 * along**2) * np.exp(-0.5 * (depth + 0.5 * curvature * back[:, None] ** 2) ** 2)
    tau = -np.log1p(-alpha).sum() * density * spacing * 10 * spacing
    assert 1.0 - math.exp(-tau) == pytest.approx(0.5, abs=0.01)


def test_thin_sheets_keep_their_sides_apart():
    for thickness in (0.004, 0.01, 0.03):
        sheet = surface_on_grid(METHOD.extractor, box_sdf((0.6, 0.5, 0.5 * thickness)), 32)
        gaussians = new_gaussians(FaceBarycentricConfig(), sheet, blur=0.01)
        level = gaussians.rotations[:, 2, 0].abs() > 0.9999
        heights = (gaussians.means[:, 2] * gaussians.rotations[:, 2, 0])[level]
        assert level.float().mean() > 0.6
        assert (heights > 0.099 * thickness).all()
        assert (heights < 0.5 * thickness).all()


def centroids_and_normals(solid: Surface) -> tuple[Tensor, Tensor]:
    corners = face_corners(solid.vertices, solid.faces)
    return corners.mean(dim=1).T.contiguous(), face_normals(corners).T.contiguous()


def test_thickness_of_a_turned_plate():
    centroids, normals = centroids_and_normals(surface("plate", 64))
    thickness = thicknesses(centroids, normals, column=0.1)
    found = thickness.isfinite()
    assert found.float().mean() > 0.8
    torch.testing.assert_close(thickness[found].median(), torch.tensor(0.1), atol=1e-3, rtol=0)
    # Round its edges it is thinner.
    assert (thickness[found] > 0.08).float().mean() > 0.95


def test_a_gap_between_two_solids_is_no_sheet():
    corners = torch.tensor([[[0.0, 0, 0], [0, 1, 0], [1, 0, 0]], [[0.0, 0, 0.1], [1, 0, 0.1], [0, 1, 0.1]]])
    centroids, normals = corners.mean(dim=1).T, face_normals(corners).T
    torch.testing.assert_close(thicknesses(centroids, normals, column=2.0), torch.tensor([0.1, 0.1]))
    assert thicknesses(centroids, -normals, column=2.0).isinf().all()


def test_neighbours():
    faces = tetrahedron().faces
    across = neighbours(faces)
    for face, edge in product(range(4), range(3)):
        ends = {int(faces[face, edge]), int(faces[face, (edge + 1) % 3])}
        assert across[face, edge] != face
        assert ends <= set(faces[across[face, edge]].tolist())
    # Without a neighbour, and with too many.
    assert neighbours(faces[:1]).tolist() == [[0, 0, 0]]
    fan = torch.tensor([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert neighbours(fan).tolist() == [[0, 0, 0], [1, 1, 1], [2, 2, 2]]


def test_trimmed_gaussians_end_at_the_neighbours_planes():
    """Seen along an edge, no Gaussian's outline stands outside the plane of the face beyond it."""
    binder, blur = FaceBarycentricConfig(), 0.004
    cube = surface_on_grid(METHOD.extractor, turned_sdf(box_sdf((0.5, 0.5, 0.5))), 16)
    corners, normals = face_corners(cube.vertices, cube.faces), face_normals(face_corners(cube.vertices, cube.faces))
    across = neighbours(cube.faces)
    outline = rim_depths(binder.theta).min()

    def standing_out(gaussians) -> Tensor:
        """How far outlines stand out of the neighbours' planes, over the filter's deviation, at bends."""
        factor = gaussians.rotations * gaussians.scales[:, None]
        theirs = normals[across]
        deviation = ((theirs @ factor).square().sum(dim=2) + blur**2).sqrt()
        depth = ((corners - gaussians.means[:, None]) * theirs).sum(dim=2)
        outside = outline * deviation - depth
        inner = (corners.mean(dim=1)[:, None] - corners.mean(dim=1)[across]) * theirs
        return (outside / blur)[inner.sum(dim=2) < -0.2 * (corners[:, 0] - corners[:, 1]).norm(dim=1)[:, None]]

    assert standing_out(new_gaussians(binder, cube, blur)).max() < 0.05
    assert standing_out(new_gaussians(replace(binder, fit_outline=False), cube, blur)).max() > 2.0


def test_the_fit_is_a_constant_of_the_step():
    """Faces move Gaussians rigidly: a gradient through angles between faces would pull on their neighbours."""
    binder = FaceBarycentricConfig().build()
    solid = tetrahedron()
    vertices = solid.vertices.double().clone().requires_grad_()
    moving = Surface(vertices=vertices, faces=solid.faces, face_keys=solid.face_keys)
    rows = binder.new_rows(len(solid.faces), vertices.device, vertices.dtype)
    means = binder.bind(moving, rows, blur=0.01).means[:, 0]
    corners = face_corners(vertices, solid.faces)
    normal = torch.nn.functional.normalize(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=1
    )
    depth = ((corners.mean(dim=1) - means) * normal).sum(dim=1).detach()
    assert (depth > 0.01).all()
    pull = torch.randn(4, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    (found,) = torch.autograd.grad((means * pull).sum(), [vertices])
    (expected,) = torch.autograd.grad(((corners.mean(dim=1) - depth[:, None] * normal) * pull).sum(), [vertices])
    torch.testing.assert_close(found, expected)


def test_binding_again_is_the_same_whatever_was_bound_between():
    binder = FaceBarycentricConfig(gaussians_per_face=3).build()
    first, second = surface("cube", 32), surface("torus", 32)
    rows = {each: binder.new_rows(len(each.faces), torch.device("cpu"), torch.float32) for each in (first, second)}
    once = binder.bind(first, rows[first], blur=0.01)
    binder.bind(second, rows[second], blur=0.01)
    again = binder.bind(first, rows[first], blur=0.01)
    for name in ("means", "scales", "rotations"):
        torch.testing.assert_close(getattr(once, name), getattr(again, name), rtol=0, atol=0)
    moved = replace(first, vertices=first.vertices * 1.01)
    assert not torch.equal(binder.bind(moved, rows[first], blur=0.01).means, once.means)
