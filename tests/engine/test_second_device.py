"""What CUDA will be asked for: training away from the CPU, none of whose kernels takes part."""

import os
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from jaxtyping import Float
from second_device import DEVICE, Away, second_device
from small_runs import ONE_STAGE, small_config, train
from torch import Tensor

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.posed_images import training_images
from sculpt_framework.rasterizers import Rasterizer, RasterOutput
from sculpt_framework.sculpting import assembly
from sculpt_framework.types import Camera, Scene
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
    monkeypatch.setattr(assembly, "pick_device", lambda wanted: DEVICE)
    # What makes tensors there is known to the thread that asked for it.
    monkeypatch.setattr(training_images, "in_threads", lambda work, items: [work(item) for item in items])
    with second_device():
        there = train(replace(config, rasterizer=AcrossConfig(drawing=drawing)), scene).result
    np.testing.assert_array_equal(there.faces, here.faces)
    np.testing.assert_allclose(there.vertices, here.vertices, rtol=0, atol=1e-4)
    np.testing.assert_allclose(there.colors, here.colors, rtol=0, atol=1e-2)
