"""What CUDA will be asked for: training away from the CPU, none of whose kernels takes part."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from jaxtyping import Float
from second_device import DEVICE, Away, second_device
from small_runs import ONE_STAGE, small_config, train
from torch import Tensor

import sculpt_framework as sculpt
from sculpt_framework import device, registry
from sculpt_framework.config import MethodConfig, RasterizerConfig
from sculpt_framework.engine.checkpoint import Progress, Saved
from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.posed_images import training_images
from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.sculpting import assembly
from sculpt_framework.sculpting.config import of_sculpting
from sculpt_framework.types import Camera, Scene
from sculpt_framework.volume_rendering import reconstructor as volume_reconstructor
from sculpt_framework.volume_rendering.config import VolumeConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.initializers.stereo.config import StereoConfig
from sculpt_plugins.losses.bending.config import BendingConfig
from sculpt_plugins.losses.consistency import loss as consistency
from sculpt_plugins.methods.sugar.config import SugarConfig
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from sculpt_plugins.rasterizers.triton.config import TritonRasterizerConfig

# Triton's kernels run in its interpreter, which has to be said before triton is imported.
if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")
INTERPRETED = pytest.mark.skipif(torch.cuda.is_available(), reason="where there is CUDA, Triton compiles")


class Across(Rasterizer):
    """Draws on the CPU what lies away from it."""

    def __init__(self, drawing: Rasterizer):
        self._drawing = drawing

    def rasterize(
        self,
        means: Float[Tensor, "g 3"],
        scales: Float[Tensor, "g 3"],
        rotations: Float[Tensor, "g 3 3"],
        opacities: Float[Tensor, " g"],
        features: Float[Tensor, "g c"],
        camera: Camera,
        background: Float[Tensor, " c"] | Float[Tensor, "h w c"],
        *,
        low_pass_px2: float,
        alpha_max: float,
    ) -> RasterOutput:
        given = (means, scales, rotations, opacities, features)
        assert all(isinstance(each, Away) for each in (*given, background, camera.world_to_camera))
        here = replace(camera, world_to_camera=camera.world_to_camera.cpu())
        out = self._drawing.rasterize(
            *(each.cpu() for each in given), here, background.cpu(), low_pass_px2=low_pass_px2, alpha_max=alpha_max
        )
        return RasterOutput(features=out.features.to(DEVICE), alpha=out.alpha.to(DEVICE), depth=out.depth.to(DEVICE))


@dataclass(frozen=True, kw_only=True)
class AcrossConfig(RasterizerConfig):
    drawing: RasterizerConfig

    def build(self, device: torch.device) -> Rasterizer:
        return Across(self.drawing.build(torch.device("cpu")))


def test_tensors_of_two_devices_do_not_mix():
    with second_device():
        there, here = torch.arange(3.0, device=DEVICE), torch.arange(3.0)
        assert isinstance(there, Away)
        with pytest.raises(RuntimeError, match="two devices"):
            there + here
        with pytest.raises(RuntimeError, match="numpy"):
            there.numpy()
        assert (there + here.to(DEVICE)).tolist() == [0.0, 2.0, 4.0]
        assert not isinstance(there.cpu(), Away)


@contextmanager
def everything_away(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whatever asks for a device gets the second one."""
    for module in (assembly, device, volume_reconstructor):
        monkeypatch.setattr(module, "pick_device", lambda wanted: DEVICE)
    # What makes tensors there is known to the thread that asked for it.
    for module in (training_images, consistency):
        monkeypatch.setattr(module, "in_threads", lambda work, items: [work(item) for item in items])
    with second_device():
        yield


@pytest.mark.parametrize(
    "drawing",
    [
        pytest.param(ReferenceRasterizerConfig(), id="reference", marks=pytest.mark.slow),
        pytest.param(TritonRasterizerConfig(), id="triton", marks=[pytest.mark.slow, INTERPRETED]),
    ],
)
def test_training_is_the_same_on_another_device(
    drawing: RasterizerConfig, scene: Scene, monkeypatch: pytest.MonkeyPatch
):
    stages = (replace(ONE_STAGE[0], image_scale=0.5, inner_steps=1),)
    config = small_config(steps=2, stages=stages, polish_steps=1, holdout_every=0)
    here = train(config, scene).result
    with everything_away(monkeypatch):
        there = train(replace(config, rasterizer=AcrossConfig(drawing=drawing)), scene).result
    np.testing.assert_array_equal(there.faces, here.faces)
    apart = np.abs(there.vertices - here.vertices)
    assert np.quantile(apart, 0.99) < 5e-5
    # Adam makes a whole step of a rounding, where a slope is next to nothing.
    assert apart.max() < 0.01 * np.ptp(here.vertices, axis=0).min() / config.trainer.base_cells
    np.testing.assert_allclose(there.colors, here.colors, rtol=0, atol=1e-2)


@pytest.mark.slow
def test_every_term_and_decision_of_the_default_works_on_another_device(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    default = of_sculpting(registry.load_method("gaussian-sculpting")())
    stages = (replace(ONE_STAGE[0], image_scale=0.5, inner_steps=1),)
    config = small_config(
        steps=3, stages=stages, polish_steps=1, warm_up_steps=1, losses=(*default.losses, BendingConfig()),
        plan=default.plan, initializer=StereoConfig(),
    )  # fmt: skip
    with everything_away(monkeypatch):
        outcome = train(replace(config, rasterizer=AcrossConfig(drawing=NumbaRasterizerConfig())), scene)
    assert len(outcome.losses) == 3
    assert np.isfinite(outcome.result.vertices).all()


@pytest.mark.parametrize(
    "name", [pytest.param("nerf", marks=pytest.mark.slow), pytest.param("neus", marks=pytest.mark.slow), "volsdf"]
)
def test_volumes_are_rendered_on_another_device(name: str, scene: Scene, monkeypatch: pytest.MonkeyPatch):
    config = sculpt.methods[name]()
    assert isinstance(config, VolumeConfig)
    radiance = replace(config.radiance, num_levels=2, log2_table=10, finest_resolution=16, hidden_units=16)
    small = replace(config, steps=3, rays=64, steps_across=24, cells=12, mesh_cells=16, radiance=radiance)
    with everything_away(monkeypatch):
        assert_lives(small, scene)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("splatting-3d", marks=pytest.mark.slow),
        "pgsr",
        pytest.param("relightable", marks=pytest.mark.slow),
        pytest.param("3dgsr", marks=pytest.mark.slow),
        pytest.param("gsdf", marks=pytest.mark.slow),
        pytest.param("sugar", marks=pytest.mark.slow),
    ],
)
def test_free_gaussians_live_on_another_device(name: str, scene: Scene, monkeypatch: pytest.MonkeyPatch):
    config = sculpt.methods[name]()
    assert isinstance(config, FreeGaussiansConfig)
    across = AcrossConfig(drawing=NumbaRasterizerConfig())
    small = replace(config, steps=8, gaussians=150, mesh_cells=12, density=replace(config.density, every=3))
    if isinstance(small, SugarConfig):
        small = replace(small, clear=0.01)  # In so few steps none gets opaque.
    with everything_away(monkeypatch):
        assert_lives(replace(small, rasterizer=across), scene)


def assert_lives(config: MethodConfig, scene: Scene) -> None:
    """To its end, and from a checkpoint in between, whose tensors are on the CPU, to the same."""
    saved: list[Saved] = []

    def save(state: Mapping[str, Tensor], progress: Progress) -> None:
        saved.append(({name: value.detach().cpu() for name, value in state.items()}, progress))

    session = sculpt.Session(scene, config, save_state=save)
    for report in session:
        if report.step == 2:
            session.save_checkpoint()
    assert session.failure is None
    mesh = session.mesh()
    assert np.isfinite(mesh.vertices).all()
    assert torch.isfinite(session.render(scene.train[0].camera).rgb.cpu()).all()
    again = sculpt.Session(scene, session.config, saved=saved[0]).run()
    np.testing.assert_array_equal(again.faces, mesh.faces)
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.colors, mesh.colors)


def test_sculpting_goes_on_from_the_cpu(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    stages = (replace(ONE_STAGE[0], image_scale=0.5, inner_steps=1),)
    learnable = FlexiCubesConfig(learn_deformation=True)
    config = small_config(steps=3, stages=stages, fit_steps=10, polish_steps=0, extractor=learnable, base_cells=6)
    with everything_away(monkeypatch):
        assert_lives(replace(config, rasterizer=AcrossConfig(drawing=NumbaRasterizerConfig())), scene)
