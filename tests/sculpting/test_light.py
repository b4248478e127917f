"""Light per image: exposure and white balance are learned, and where all images have the same it costs nothing."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import sculpt_framework as sculpt
from sculpt_framework.losses import TrainingImage
from sculpt_framework.rendering.photometric import l1_dssim
from sculpt_framework.sculpting.config import StageConfig
from sculpt_framework.stress.small import method_of, small_method, small_scene
from sculpt_framework.types import Camera, Rendering
from sculpt_plugins.losses.eikonal.config import EikonalConfig
from sculpt_plugins.losses.photometric.config import PhotometricConfig
from sculpt_plugins.losses.silhouette.config import SilhouetteConfig

CAMERA = Camera(world_to_camera=torch.eye(4), fx=10.0, fy=10.0, cx=6.0, cy=6.0, width=12, height=12)


def image(name: str = "a", seed: int = 0) -> TrainingImage:
    generator = torch.Generator().manual_seed(seed)
    alpha = (torch.rand(12, 12, generator=generator) > 0.4).float()
    rgb = torch.rand(12, 12, 3, generator=generator) * alpha[..., None]
    return TrainingImage(name=name, camera=CAMERA, premultiplied=rgb, alpha=alpha)


def rendering_of(image: TrainingImage, background: torch.Tensor) -> Rendering:
    assert image.alpha is not None
    rgb = image.premultiplied + (1 - image.alpha)[..., None] * background
    return Rendering(rgb=rgb, alpha=image.alpha, depth=image.alpha)


def test_one_light_for_all_is_the_plain_loss_and_learns_nothing():
    term, one = PhotometricConfig().build(), image()
    term.begin([one])
    background = torch.tensor([0.2, 0.5, 0.9])
    made = rendering_of(image(seed=1), background)
    assert torch.equal(term(made, one.over(background)), l1_dssim(made.rgb, one.over(background).rgb, 0.2))
    assert list(term.parameter_groups()) == []


def test_a_rendering_lit_as_the_image_is_fits_it_in_front_of_any_background():
    term, plain = PhotometricConfig(light="per-image", light_prior=0.0).build(), image()
    gain, offset = torch.tensor([0.8, 1.0, 1.3]), torch.tensor([0.05, 0.0, -0.02])
    assert plain.alpha is not None
    lit = replace(plain, premultiplied=plain.premultiplied * gain + offset * plain.alpha[..., None])
    term.begin([image("other"), lit])
    (light,) = (parameter for group in term.parameter_groups() for parameter in group.parameters)
    assert light.shape == (2, 2, 3)
    with torch.no_grad():
        light[1, 0], light[1, 1] = gain - 1, offset
    for background in (torch.zeros(3), torch.tensor([0.9, 0.1, 0.4])):
        assert float(term(rendering_of(plain, background), lit.over(background)).detach()) < 1e-6


def test_gradients_are_those_of_finite_differences():
    term, one = PhotometricConfig(light="per-image").build(), image()
    term.begin([one])
    (light,) = (parameter for group in term.parameter_groups() for parameter in group.parameters)
    assert one.alpha is not None
    target = replace(one, premultiplied=one.premultiplied.double(), alpha=one.alpha.double()).over(
        torch.rand(3).double()
    )
    generator = torch.Generator().manual_seed(3)
    rgb = torch.rand(12, 12, 3, generator=generator, dtype=torch.float64, requires_grad=True)
    alpha = torch.rand(12, 12, generator=generator, dtype=torch.float64, requires_grad=True)
    light.data = 0.1 * torch.randn(1, 2, 3, generator=generator, dtype=torch.float64)

    def value(rgb: torch.Tensor, alpha: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        return term(Rendering(rgb=rgb, alpha=alpha, depth=alpha), target)

    assert gradcheck(value, (rgb, alpha, light), fast_mode=True)


@pytest.fixture(scope="module")
def tinted() -> tuple[sculpt.Scene, np.ndarray]:
    """Each photograph in a light of its own, and its gains, views by channels."""
    scene = small_scene(views=8)
    gains = np.random.default_rng(2).uniform(0.6, 1.0, (8, 3)).astype(np.float32)
    views = tuple(
        replace(view, rgb=view.rgb * torch.from_numpy(gain)) for view, gain in zip(scene.train, gains, strict=True)
    )
    return replace(scene, train=views), gains


@pytest.mark.slow
def test_exposure_and_white_balance_are_found(tinted: tuple[sculpt.Scene, np.ndarray]):
    scene, gains = tinted
    stage = StageConfig(share=1.0, level=0, image_scale=1.0, inner_steps=6, outer_views=2)
    losses = (
        PhotometricConfig(light="per-image", light_rate=0.02, light_prior=1e-3),
        SilhouetteConfig(),
        EikonalConfig(),
    )
    config = small_method(60, holdout_every=0, losses=losses)
    config = replace(config, trainer=replace(config.trainer, stages=(stage,)))
    session = sculpt.Session(scene, config)
    session.run()
    term = method_of(session).trainer.objectives.inner.term
    (light,) = (parameter.detach().numpy() for group in term.parameter_groups() for parameter in group.parameters)
    # What a gain and an offset together make of the mean colour: one can stand in for the other.
    means = [
        view.rgb[view.alpha > 0.5].mean(dim=0).numpy() / gain for view, gain in zip(scene.train, gains, strict=True)
    ]
    made = [(1 + gain) * mean + offset for (gain, offset), mean in zip(light, means, strict=True)]
    errors = np.log(np.stack(made) / np.stack(means) / gains)
    # Up to one factor per channel, which colours may take as well.
    errors -= errors.mean(axis=0)
    before = np.log(gains) - np.log(gains).mean(axis=0)
    assert np.sqrt((errors**2).mean()) < 0.4 * np.sqrt((before**2).mean())
