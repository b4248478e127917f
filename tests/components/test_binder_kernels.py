"""The binder's compiled kernels in float32 against plain torch in float64."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import pytest
import torch
from torch import Tensor

from sculpt_framework.binders import Binding
from sculpt_framework.geometry.faces import face_corners, face_normals
from sculpt_framework.testing import tetrahedron
from sculpt_framework.types import Surface
from sculpt_plugins.binders.face_barycentric.compiled import neighbourhood_compiled
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.binders.face_barycentric.in_torch import bind_in_torch, normal_and_radii
from sculpt_plugins.binders.face_barycentric.outline import neighbourhood_of
from tests.components.test_binder import triangle_surface

OUTPUTS = ("means", "scales", "rotations", "opacities", "barycentrics", "tangent_covariance", "tangent_corners")
CONFIGS = [
    FaceBarycentricConfig(),
    FaceBarycentricConfig(gaussians_per_face=3, opacity="learnable"),
    FaceBarycentricConfig(reference="edges", rotation_rate=0.0, fit_outline=False),
    FaceBarycentricConfig(gaussians_per_face=2, reference="edges"),
    FaceBarycentricConfig(gaussians_per_face=2, fit_outline=False, rotation_rate=0.0),
]


def _plate() -> Surface:
    """A thin box: two sides that are near each other, and sharp edges all round."""
    from trimesh.creation import box

    plate = box((0.8, 0.6, 0.02)).subdivide().subdivide()
    return Surface(
        vertices=torch.from_numpy(plate.vertices.copy()).float(),
        faces=torch.from_numpy(plate.faces.copy()).long(),
        face_keys=torch.arange(len(plate.faces)),
    )


def _ball() -> Surface:
    from trimesh.creation import icosphere

    ball = icosphere(3, 0.7)
    noise = torch.randn(len(ball.vertices), 3, generator=torch.Generator().manual_seed(3))
    return Surface(
        vertices=torch.from_numpy(ball.vertices.copy()).float() + 0.005 * noise,
        faces=torch.from_numpy(ball.faces.copy()).long(),
        face_keys=torch.arange(len(ball.faces)),
    )


def _slivers() -> Surface:
    """Faces without area, with one side, and with heights of down to a millionth of their length."""
    corners = torch.tensor(
        [
            [[0.0, 0, 0], [0, 0, 0], [0, 0, 0]],
            [[0.0, 0, 0], [1, 0, 0], [1, 0, 0]],
            [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]],
            [[0.1, 0, 0], [1, 0, 0], [0.5, 1e-3, 0]],
            [[0.1, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]],
            [[0.2, 0.1, 0], [0.2, 0.1001, 0], [0.2, 0.1, 1e-4]],
        ]
    )
    return triangle_surface(corners)


@pytest.mark.parametrize("reference", ["steiner", "edges"])
@pytest.mark.parametrize("surface", [_plate(), _ball(), _slivers(), tetrahedron()])
def test_the_neighbourhood_is_that_of_torch(surface: Surface, reference: Literal["steiner", "edges"]):
    surface = replace(surface, vertices=surface.vertices.float())
    corners = face_corners(surface.vertices, surface.faces)
    expected = neighbourhood_of(surface.faces, corners, *normal_and_radii(corners, reference))
    found = neighbourhood_compiled(surface, reference)
    for name in ("outward", "heights", "cosine", "sine", "reach"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), atol=1e-5, rtol=1e-4, msg=name)
    assert found.area == pytest.approx(expected.area, rel=1e-5)
    # Faces of one column and one place are in no order.
    alike = torch.isclose(found.thickness, expected.thickness, atol=1e-5)
    assert alike.float().mean() > 0.95


def test_the_neighbourhood_finds_sheets_and_open_edges():
    plate = _plate()
    thickness = neighbourhood_compiled(plate, "steiner").thickness
    broad = (face_normals(face_corners(plate.vertices, plate.faces))[:, 2].abs() > 0.9) & thickness.isfinite()
    assert broad.float().mean() > 0.3
    torch.testing.assert_close(thickness[broad], torch.full_like(thickness[broad], 0.02))
    fan = torch.tensor([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0], [0.5, 0, 1]])
    neighbourhood = neighbourhood_compiled(Surface(vertices=vertices, faces=fan, face_keys=torch.arange(3)), "steiner")
    torch.testing.assert_close(neighbourhood.cosine, torch.ones(3, 3))
    assert (neighbourhood.sine == 0).all()


def test_a_vertex_that_is_no_number_shows_in_the_relief():
    ball = _ball()
    vertices = ball.vertices.clone()
    vertices[0, 1] = torch.nan
    neighbourhood = neighbourhood_compiled(replace(ball, vertices=vertices), "steiner")
    touched = (ball.faces == 0).any(dim=1)
    assert neighbourhood.heights[:, touched].isnan().all()
    assert neighbourhood.sine[:, touched].isnan().all()


def _rows(config: FaceBarycentricConfig, surface: Surface) -> dict[str, Tensor]:
    """Rows as after some training: no two alike."""
    fresh = config.build().new_rows(len(surface.faces), torch.device("cpu"), torch.float32)
    generator = torch.Generator().manual_seed(4)
    return {name: row + 0.2 * torch.randn(row.shape, generator=generator) for name, row in fresh.items()}


def _bound(
    config: FaceBarycentricConfig, surface: Surface, rows: dict[str, Tensor], dtype: torch.dtype, blur: float = 0.005
) -> tuple[Binding, dict[str, Tensor]]:
    """The binding, and all gradients of a random weighting of everything in it."""
    leaves = {"vertices": surface.vertices, **rows}
    leaves = {name: leaf.to(dtype).clone().requires_grad_(True) for name, leaf in leaves.items()}
    vertices = leaves["vertices"]
    binding = config.build().bind(replace(surface, vertices=vertices), leaves_of_rows(leaves), blur=blur)
    generator = torch.Generator().manual_seed(5)
    total = vertices.new_zeros(())
    for name in OUTPUTS:
        output = getattr(binding, name)
        total = total + (output * torch.randn(output.shape, dtype=torch.float64, generator=generator).to(dtype)).sum()
    total.backward()
    return binding, {name: leaf.grad for name, leaf in leaves.items() if leaf.grad is not None}


def leaves_of_rows(leaves: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: leaf for name, leaf in leaves.items() if name != "vertices"}


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("shape", [_plate, _ball, tetrahedron])
def test_kernels_do_what_torch_does(config: FaceBarycentricConfig, shape: Callable[[], Surface]):
    surface = replace(shape(), vertices=shape().vertices.float())
    rows = _rows(config, surface)
    expected, expected_gradients = _bound(config, surface, rows, torch.float64)
    binding, gradients = _bound(config, surface, rows, torch.float32)
    for name in OUTPUTS:
        value, twin = getattr(binding, name).detach(), getattr(expected, name).detach()
        assert (value - twin).abs().max() < 2e-5 * max(1.0, float(twin.abs().max())), name
    assert gradients.keys() == expected_gradients.keys()
    for name, gradient in gradients.items():
        error = (gradient.double() - expected_gradients[name]).norm() / expected_gradients[name].norm()
        assert error < 1e-4, name


@pytest.mark.parametrize("theta", [0.1, 0.2])
@pytest.mark.parametrize("on_an_edge", [False, True])
def test_opacities_whose_few_layers_never_cover_half(theta: float, on_an_edge: bool):
    """Gaussians lie in their faces there, and have no outline to trim; those on an edge lie in two planes."""
    config, surface = FaceBarycentricConfig(theta=theta), _plate()
    rows = _rows(config, surface)
    if on_an_edge:
        rows["barycentric_logits"][:, 0, 0] = -1e3
    expected, expected_gradients = _bound(config, surface, rows, torch.float64)
    binding, gradients = _bound(config, surface, rows, torch.float32)
    for name in OUTPUTS:
        value, twin = getattr(binding, name).detach(), getattr(expected, name).detach()
        assert torch.isfinite(twin).all(), name
        torch.testing.assert_close(value.double(), twin, atol=2e-5, rtol=2e-5, msg=name)
    for name, gradient in gradients.items():
        assert torch.isfinite(expected_gradients[name]).all(), name
        error = (gradient.double() - expected_gradients[name]).norm() / expected_gradients[name].norm()
        assert error < 1e-4, name


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("blur", [0.0, 0.01])
def test_faces_without_area(config: FaceBarycentricConfig, blur: float):
    surface = _slivers()
    rows = _rows(config, surface)
    binding, gradients = _bound(config, surface, rows, torch.float32, blur)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sculpt_plugins.binders.face_barycentric.binder.bind_compiled", bind_in_torch)
        twin, twin_gradients = _bound(config, surface, rows, torch.float32, blur)
    for name in OUTPUTS:
        value = getattr(binding, name).detach()
        assert torch.isfinite(value).all(), name
        torch.testing.assert_close(value, getattr(twin, name).detach(), rtol=1e-3, atol=1e-5)
    for name, gradient in gradients.items():
        assert torch.isfinite(gradient).all(), name
        torch.testing.assert_close(gradient, twin_gradients[name], rtol=1e-2, atol=1e-3 * float(gradient.abs().max()))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_normal_of_a_tiny_face_teaches_little(dtype: torch.dtype):
    """A face with sides of 1e-5: the exact gradient of its normal, 1 / height, is as of a face of 1e-6 in area."""
    config, side = FaceBarycentricConfig(normal_scale=1e-3), 1e-5
    corners = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[2.0, 0, 0], [2 + side, 0, 0], [2, side, 0]]])
    surface = triangle_surface(corners.double())
    vertices = (surface.vertices - surface.vertices[surface.faces[1, 0]]).to(dtype).requires_grad_(True)
    rows = config.build().new_rows(2, torch.device("cpu"), dtype)
    binding = config.build().bind(replace(surface, vertices=vertices), rows, blur=0.0)
    binding.rotations[:, 0, 0, 0].sum().backward()
    assert vertices.grad is not None
    # Raising the second corner by h tilts the normal by h / side along x.
    large, tiny = (vertices.grad[surface.faces[face, 1]] for face in (0, 1))
    torch.testing.assert_close(large, torch.tensor([0.0, 0.0, -1.0], dtype=dtype))
    torch.testing.assert_close(tiny, torch.tensor([0.0, 0.0, -1.0 / side * side**2 / 1e-6], dtype=dtype))


def test_a_vertex_that_is_not_a_number_shows():
    surface = _ball()
    vertices = surface.vertices.clone()
    vertices[7, 1] = float("nan")
    config = FaceBarycentricConfig(fit_outline=False)
    binding = config.build().bind(replace(surface, vertices=vertices), _rows(config, surface), blur=0.01)
    hurt = (surface.faces == 7).any(dim=1)
    assert torch.isnan(binding.means[hurt]).any(dim=(1, 2)).all()
    assert torch.isfinite(binding.means[~hurt]).all()


def test_only_what_is_asked_for_is_differentiated():
    """A detached surface: the corners in the tangent frame are constants, and the rows' gradients the same as ever."""
    config, surface = CONFIGS[1], _ball()
    rows = _rows(config, surface)
    _, expected = _bound(config, surface, rows, torch.float32)
    leaves = {name: row.clone().requires_grad_(True) for name, row in rows.items()}
    binding = config.build().bind(surface, leaves, blur=0.005)
    assert not binding.tangent_corners.requires_grad
    generator = torch.Generator().manual_seed(5)
    weights = {
        name: torch.randn(getattr(binding, name).shape, dtype=torch.float64, generator=generator) for name in OUTPUTS
    }
    sum((getattr(binding, name) * weights[name].float()).sum() for name in OUTPUTS).backward()
    for name, leaf in leaves.items():
        torch.testing.assert_close(leaf.grad, expected[name])
    # One output alone: the others have no gradient at all.
    for name in ("means", "tangent_covariance"):
        leaf = surface.vertices.clone().requires_grad_(True)
        alone = config.build().bind(replace(surface, vertices=leaf), rows, blur=0.005)
        getattr(alone, name).sum().backward()
        double = surface.vertices.double().requires_grad_(True)
        twin_rows = {key: row.double() for key, row in rows.items()}
        twin = config.build().bind(replace(surface, vertices=double), twin_rows, blur=0.005)
        getattr(twin, name).sum().backward()
        assert (leaf.grad - double.grad).norm() < 1e-4 * double.grad.norm()


def test_repeats_to_the_last_bit_on_any_number_of_threads():
    before, results = torch.get_num_threads(), []
    surface, config = _ball(), CONFIGS[1]
    for threads in (1, 2, 2):
        torch.set_num_threads(threads)
        binding, gradients = _bound(config, surface, _rows(config, surface), torch.float32)
        results.append([*(getattr(binding, name) for name in OUTPUTS), *gradients.values()])
    torch.set_num_threads(before)
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))
