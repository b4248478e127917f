"""What is handed to gsplat, by a stand-in with its signature that draws with the reference."""

import sys
from dataclasses import replace
from types import ModuleType

import pytest
import torch
from torch import Tensor

from sculpt_framework.errors import ComponentImportError, DeviceError
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.gsplat.config import GsplatRasterizerConfig
from sculpt_plugins.rasterizers.gsplat.rasterizer import GsplatRasterizer, load_gsplat
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from tests.rasterizers.backends import CPU
from tests.rasterizers.splats import INPUTS, facing_splats, random_splats, rendered


def rasterization(
    means: Tensor,
    quats: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    packed: bool = True,
    render_mode: str = "RGB",
    rasterize_mode: str = "classic",
    covars: Tensor | None = None,
) -> tuple[Tensor, Tensor, dict]:
    """As gsplat 1.5.3 has it: covariances instead of quaternions and scales, one camera, depth as the last channel."""
    assert quats is None
    assert scales is None
    assert covars is not None
    assert covars.shape == (means.shape[0], 3, 3)
    assert viewmats.shape == (1, 4, 4)
    assert Ks.shape == (1, 3, 3)
    assert not packed
    assert (render_mode, rasterize_mode, near_plane) == ("RGB+D", "classic", 0.01)
    variances, axes = torch.linalg.eigh(covars)
    (fx, _, cx), (_, fy, cy), last = Ks[0].tolist()
    assert last == [0.0, 0.0, 1.0]
    camera = Camera(world_to_camera=viewmats[0], fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)
    nothing = torch.zeros(colors.shape[1], dtype=colors.dtype)
    output = (
        ReferenceRasterizerConfig()
        .build(CPU)
        .rasterize(
            means,
            variances.clamp(min=0.0).sqrt(),
            axes,
            opacities,
            colors,
            camera,
            nothing,
            low_pass_px2=eps2d,
            alpha_max=0.999,
        )
    )
    images = torch.cat([output.features, output.depth[..., None]], dim=-1)
    return images[None], output.alpha[None, ..., None], {}


def _module(function: object) -> ModuleType:
    module = ModuleType("gsplat")
    module.rasterization = function  # pyright: ignore[reportAttributeAccessIssue]
    return module


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_arguments(channels: int, monkeypatch: pytest.MonkeyPatch):
    """Images and gradients come out as from the reference: shapes, frames and intrinsics are what gsplat expects."""
    monkeypatch.setitem(sys.modules, "gsplat", _module(rasterization))
    splats = random_splats(count=40, channels=channels)
    expected, expected_gradients = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    output, gradients = rendered(GsplatRasterizer(load_gsplat(CPU)), splats, torch.float32)
    for name in ("features", "alpha", "depth"):
        torch.testing.assert_close(getattr(output, name).double(), getattr(expected, name), rtol=1e-4, atol=1e-4)
    for name in INPUTS:
        error = (gradients[name] - expected_gradients[name]).norm() / expected_gradients[name].norm()
        assert error < 1e-3, name


def test_axes_that_are_not_orthogonal_and_a_background_per_pixel():
    splats = random_splats(count=40)
    skewed = splats.rotations.clone()
    skewed[:, :, 2] = torch.nn.functional.normalize(skewed[:, :, 2] + 0.5 * skewed[:, :, 1], dim=1)
    image = torch.rand(splats.camera.height, splats.camera.width, 3, dtype=torch.float64)
    splats = replace(splats, rotations=skewed, background=image)
    expected, _ = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    output, _ = rendered(GsplatRasterizer(rasterization), splats, torch.float32)
    torch.testing.assert_close(output.features.double(), expected.features, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_not_finite_is_left_out(value: float):
    splats = random_splats(count=12)
    means, scales, features = splats.means.clone(), splats.scales.clone(), splats.features.clone()
    means[3, 1], scales[5, 0], features[7, 2] = value, value, value
    keep = torch.tensor([i not in (3, 5, 7) for i in range(12)])
    without = replace(splats, **{name: getattr(splats, name)[keep] for name in INPUTS[:5]})
    expected, expected_gradients = rendered(GsplatRasterizer(rasterization), without, torch.float32)
    broken = replace(splats, means=means, scales=scales, features=features)
    output, gradients = rendered(GsplatRasterizer(rasterization), broken, torch.float32)
    torch.testing.assert_close(output.features, expected.features)
    for name in INPUTS[:5]:
        assert (gradients[name][~keep] == 0).all()
        torch.testing.assert_close(gradients[name][keep], expected_gradients[name])


@pytest.mark.parametrize("count", [0, 3])
def test_nothing_to_draw(count: int):
    """gsplat is not called at all."""
    splats = facing_splats(torch.full((count, 3), float("nan")), torch.ones(count, 3), size=8)
    splats = replace(splats, background=torch.tensor([0.1, 0.5, 0.9], dtype=torch.float64))
    output, gradients = rendered(GsplatRasterizer(lambda: None), splats, torch.float32)
    torch.testing.assert_close(output.features, splats.background.float().expand(8, 8, 3))
    assert (output.alpha == 0).all()
    assert all((gradient == 0).all() for gradient in gradients.values())


@pytest.mark.parametrize(
    ("change", "message"),
    [({"alpha_max": 0.99}, "no other than 0.999"), ({"low_pass_px2": -0.1}, "low_pass_px2")],
)
def test_limits(change: dict, message: str):
    with pytest.raises(ValueError, match=message):
        rendered(GsplatRasterizer(rasterization), replace(random_splats(count=3), **change), torch.float32)


def test_errors_say_what_to_install(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(DeviceError, match="--rasterizer auto"):
        GsplatRasterizerConfig().build(CPU)
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(ComponentImportError, match=r"pip install 'gaussian-sculpting\[gsplat\]'"):
        load_gsplat(CPU)

    def without_a_compiler(**arguments: object) -> None:
        raise AttributeError("'NoneType' object has no attribute 'projection_ewa_3dgs_fused_fwd'")

    monkeypatch.setitem(sys.modules, "gsplat", _module(without_a_compiler))
    with pytest.raises(DeviceError, match="nvcc"):
        load_gsplat(CPU)
