"""What photographs show around the object: it stays behind, learns in the inner loop, and comes out on demand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import Float
from torch import Tensor

import sculpt_framework as sculpt
from sculpt_framework.cli.export import export
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.export.gaussian_files import read_gaussians_ply
from sculpt_framework.losses import ImageLoss, Target, TrainingImage
from sculpt_framework.parallel.processes import Alone
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig, TrainerConfig
from sculpt_framework.sculpting.own_parameters import OwnParameters
from sculpt_framework.sculpting.state import capture, restore
from sculpt_framework.sculpting.view_gradients import ViewGradients, Weighted
from sculpt_framework.stress.small import method_of, small_method, small_scene
from sculpt_framework.types import Camera, Gaussians, Rendering, Scene, View
from sculpt_plugins.backgrounds.gaussians.background import FreeBackground
from sculpt_plugins.backgrounds.gaussians.config import GaussiansBackgroundConfig
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig

CPU = torch.device("cpu")
STAGE = StageConfig(share=1.0, level=0, image_scale=1.0, inner_steps=2, outer_views=2)
CAMERA = Camera(
    world_to_camera=torch.eye(4, dtype=torch.float64), fx=20.0, fy=20.0, cx=8.0, cy=8.0, width=16, height=16
)


def sky(view: View) -> Float[Tensor, "h w 3"]:
    """A colour for each direction in the world, as of something far away."""
    camera = view.camera
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], axis=2)
    world = rays @ camera.world_to_camera[:3, :3].double().numpy()
    world /= np.linalg.norm(world, axis=2, keepdims=True)
    return torch.from_numpy(0.5 + 0.4 * np.sin(3.0 * world)).float()


def before_the_sky(scene: Scene) -> Scene:
    def whole(view: View) -> View:
        assert view.alpha is not None
        alpha = view.alpha[..., None]
        return replace(view, rgb=alpha * view.rgb + (1 - alpha) * sky(view))

    return replace(scene, train=tuple(whole(view) for view in scene.train))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return before_the_sky(small_scene(views=8))


def config_of(steps: int = 4, **changes: object) -> SculptingConfig:
    background = GaussiansBackgroundConfig(around=1.0, near=50, far=600)
    config = small_method(steps, holdout_every=0, background=background, **changes)
    return replace(config, trainer=replace(config.trainer, stages=(STAGE,)))


def some(seed: int, count: int, depth: float) -> Gaussians:
    random = torch.Generator().manual_seed(seed)
    means = torch.rand(count, 3, generator=random, dtype=torch.float64) - 0.5
    means[:, 2] += depth
    return Gaussians(
        means=means.requires_grad_(),
        scales=(0.1 + 0.1 * torch.rand(count, 3, generator=random, dtype=torch.float64)).requires_grad_(),
        rotations=torch.eye(3, dtype=torch.float64).repeat(count, 1, 1),
        opacities=(0.3 + 0.5 * torch.rand(count, generator=random, dtype=torch.float64)).requires_grad_(),
        sh=torch.rand(count, 1, 3, generator=random, dtype=torch.float64).requires_grad_(),
        face=torch.full((count,), -1),
    )


class Difference(ImageLoss):
    """Of colours, with the object's alpha."""

    def __call__(self, rendering: Rendering, target: Target) -> Float[Tensor, ""]:
        return (rendering.rgb - target.rgb).square().mean() + 0.1 * rendering.alpha.square().mean()


def looked_at(front: Gaussians, behind: Gaussians) -> tuple[float, list[tuple[Tensor, Tensor]]]:
    """The value of a step of one view, and what it has a gradient by, with that."""
    photograph = torch.full((16, 16, 3), 0.25, dtype=torch.float64)
    image = TrainingImage(
        name="a", camera=CAMERA, premultiplied=photograph, alpha=torch.ones(16, 16).double(), photograph=photograph
    )
    views = ViewGradients(
        ReferenceRasterizerConfig().build(CPU), TrainerConfig(stages=(STAGE,), base_cells=8), torch.Generator()
    )
    terms = [Weighted(name="difference", weight=1.0, term=Difference())]
    deferred, told = views.render_and_backward(front, [image], 1, terms, Alone(), OwnParameters([]), behind)
    return told["difference"], list(zip(deferred.roots, deferred.gradients, strict=True))


def test_gradients_by_object_and_background_are_those_of_finite_differences():
    front, behind = some(1, 4, 2.0), some(2, 5, 6.0)
    _, gradients = looked_at(front, behind)
    by = {id(root): gradient for root, gradient in gradients}
    step = 1e-6
    for gaussians in (front, behind):
        for values in (gaussians.means, gaussians.scales, gaussians.opacities, gaussians.sh):
            flat, gradient = values.detach().view(-1), by[id(values)].view(-1)
            assert bool(gradient.any())
            for place in (0, len(flat) - 1):
                kept = float(flat[place])
                flat[place] = kept + step
                more, _ = looked_at(front, behind)
                flat[place] = kept - step
                less, _ = looked_at(front, behind)
                flat[place] = kept
                assert float(gradient[place]) == pytest.approx((more - less) / (2 * step), rel=1e-4, abs=1e-9)


def test_the_object_hides_it_even_where_it_is_nearer():
    opaque = replace(some(3, 1, 3.0), scales=torch.full((1, 3), 5.0).double(), opacities=torch.ones(1).double())
    front, behind = (replace(opaque, sh=torch.full((1, 1, 3), value).double()) for value in (-1.0, 1.0))
    nearer = replace(behind, means=behind.means.detach() * 0.5)
    value, _ = looked_at(front, nearer)
    alone, _ = looked_at(front, replace(nearer, opacities=torch.zeros(1).double()))
    # An opaque Gaussian lets a thousandth through.
    assert value == pytest.approx(alone, abs=2e-3)


def test_it_learns_in_the_inner_loop_and_the_surface_in_the_outer_one(scene: Scene):
    session = sculpt.Session(scene, config_of(steps=1))
    next(iter(session))
    method = method_of(session)
    trainer, images = method.trainer, method.images
    background = trainer.background
    assert background is not None
    assert all(image.photograph is not None for image in images)
    before = [parameter.detach().clone() for parameter in background.parameters]
    settled = trainer.settle(images, STAGE, 1.0)
    inner = [parameter.detach().clone() for parameter in background.parameters]
    assert not all(torch.equal(one, other) for one, other in zip(before, inner, strict=True))
    field = [parameter.detach().clone() for parameter in trainer.field.parameters()]
    trainer.update(settled, images, STAGE, 1.0)
    assert all(torch.equal(one, other) for one, other in zip(inner, background.parameters, strict=True))
    assert not all(torch.equal(one, other) for one, other in zip(field, trainer.field.parameters(), strict=True))


def test_all_pixels_are_explained_and_the_mesh_does_not_paint_the_sky(scene: Scene):
    session = sculpt.Session(scene, config_of(steps=12))
    mesh = session.run()
    trainer, view = method_of(session).trainer, scene.train[2]
    assert trainer.background is not None
    camera = scene.box.camera_to_object(view.camera).to(CPU, torch.float32)
    with torch.no_grad():
        drawn = method_of(session).parts.rasterizer.render(
            trainer.background.gaussians(), camera, torch.zeros(3), low_pass_px2=0.05
        )
    outside = view.alpha == 0
    error = (drawn.rgb - sky(view))[outside].abs().mean()
    assert float(error) < 0.05
    assert float(np.abs(mesh.vertices).max()) < 1.0


def test_a_run_goes_on_as_if_it_had_not_stopped(scene: Scene):
    session = sculpt.Session(scene, config_of(steps=2))
    for _ in session:
        pass
    method = method_of(session)
    state = capture(method.trainer, 0, torch.Generator())
    other = method_of(sculpt.Session(scene, config_of(steps=2)))
    restore(other.trainer, torch.Generator(), state)
    assert other.trainer.background is not None
    again = capture(other.trainer, 0, torch.Generator())
    assert any(name.startswith("background/") for name in state)
    assert state.keys() == again.keys()
    assert all(torch.equal(state[name], again[name]) for name in state if name != "random")


def test_a_number_that_is_none_is_found(scene: Scene):
    session = sculpt.Session(scene, config_of(steps=1))
    next(iter(session))
    method = method_of(session)
    assert method.trainer.background is not None
    with torch.no_grad():
        method.trainer.background.parameters[0][0] = torch.nan
    with pytest.raises(FloatingPointError, match="background"):
        method.trainer.settle(method.images, STAGE, 1.0)


def test_it_begins_beside_the_object_in_the_colours_that_photographs_show(scene: Scene):
    background = FreeBackground(GaussiansBackgroundConfig(near=100, far=400), CPU)
    random = np.random.default_rng(0)
    on_it = 0.2 * random.standard_normal((200, 3))
    ways = random.standard_normal((200, 3))
    beside = 20.0 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    background.begin(scene.train, scene.box, np.concatenate([on_it, beside]), torch.Generator().manual_seed(0))
    with torch.no_grad():
        gaussians = background.gaussians()
    means = gaussians.means.detach()
    distances = means.norm(dim=1)
    assert float(distances.min()) > 5.0
    # Both kinds are there: points at 20, and a shell four times as far as the cameras.
    assert int((distances < 21).sum()) > 20
    assert int((distances > 10).sum()) > 100
    for view in scene.train:
        camera = scene.box.camera_to_object(view.camera)
        pixels = camera.project(means.double().numpy())
        shown = camera.shows(pixels)
        rows, columns = (pixels[shown, axis].astype(int).clip(max=47) for axis in (1, 0))
        free = view.alpha.numpy()[rows, columns] == 0 if view.alpha is not None else np.ones(len(rows), bool)
        colors = 0.5 + 0.28209479 * gaussians.sh[torch.from_numpy(shown), 0].numpy()
        assert np.abs(colors[free] - sky(view).numpy()[rows[free], columns[free]]).max() < 0.15


def test_views_of_nothing_but_the_object_are_refused(scene: Scene):
    full = tuple(replace(view, alpha=torch.ones_like(view.rgb[..., 0])) for view in scene.train)
    with pytest.raises(DataError, match="nothing but the object"):
        FreeBackground(GaussiansBackgroundConfig(), CPU).begin(full, scene.box, None, torch.Generator())


@pytest.mark.parametrize("around", [0.0, 0.5, 10.0])
def test_images_reach_around_the_object_as_far_as_the_photograph_does(scene: Scene, around: float):
    view = scene.train[0]
    plain = prepare_image(view, scene.box, 1.0, CPU)
    image = prepare_image(view, scene.box, 1.0, CPU, around=around)
    assert plain.photograph is None
    assert image.photograph is not None
    assert image.camera.width >= plain.camera.width
    if around == 10.0:
        assert (image.camera.width, image.camera.height) == (view.camera.width, view.camera.height)
        torch.testing.assert_close(image.photograph, view.rgb)
    assert image.whole().rgb is image.photograph


def test_both_come_out_on_demand(scene: Scene, tmp_path: Path):
    session = sculpt.Session(scene, config_of(steps=2))
    session.run()
    run = tmp_path / "run"
    saved = session.save(run)
    assert saved["background"].name == "background.ply"
    front, behind = read_gaussians_ply(run / "gaussians.ply"), read_gaussians_ply(saved["background"])
    out = tmp_path / "whole.ply"
    words = [str(run), "--format", "gaussians", "--background", "--out"]
    export([*words, str(out)])
    whole = read_gaussians_ply(out)
    assert len(whole) == len(front) + len(behind)
    torch.testing.assert_close(whole.means[len(front) :], behind.means)
    own = run / "gaussians.ply"
    with pytest.raises(ConfigError, match="of the object alone"):
        export([*words, str(own)])
    assert len(read_gaussians_ply(own)) == len(front)
    saved["background"].unlink()
    with pytest.raises(ConfigError, match="train with --background gaussians"):
        export([*words, str(out)])
