"""Terms a third party might write, against the public contract only: they learn what they should."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import sculpt_framework as sculpt
from sculpt_framework import registry
from sculpt_framework.config import LossConfig
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.checkpoint import Progress, read_checkpoint, write_checkpoint
from sculpt_framework.errors import ConfigError
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.export.mesh_pixels import draw_mesh
from sculpt_framework.losses import ImageLoss, Target, TrainingImage
from sculpt_framework.parameters import ParameterGroup
from sculpt_framework.posed_images.training_images import prepare_images
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig
from sculpt_framework.stress.small import method_of, small_method, small_scene, truth_of
from sculpt_framework.types import Rendering
from sculpt_plugins.initializers.sphere.config import SphereConfig
from sculpt_plugins.losses.eikonal.config import EikonalConfig
from sculpt_plugins.losses.photometric.config import PhotometricConfig
from sculpt_plugins.losses.silhouette.config import SilhouetteConfig

STAGE = StageConfig(share=1.0, level=0, image_scale=1.0, inner_steps=6, outer_views=2)


# -- an exposure for each image --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ExposureConfig(LossConfig):
    weight: float = 1.0
    rate: float = 0.02

    def build(self) -> "Exposure":
        return Exposure(self.rate)


class Exposure(ImageLoss):
    """Absolute difference after one gain per image, which is learned and drawn towards 1."""

    inner = True

    def __init__(self, rate: float):
        self._rate = rate
        self.numbers: dict[str, int] = {}
        self.logs = nn.Parameter(torch.zeros(0))

    def begin(self, images: Sequence[TrainingImage]) -> None:
        if not self.numbers:
            self.numbers = {image.name: number for number, image in enumerate(images)}
            self.logs = nn.Parameter(torch.zeros(len(images)))

    def parameter_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup(parameters=[self.logs], rate=self._rate)]

    def __call__(self, rendering: Rendering, target: Target) -> Tensor:
        assert target.alpha is not None
        log = self.logs[self.numbers[target.name]]
        inside = target.alpha[..., None]
        return (inside * (rendering.rgb * log.exp() - target.rgb)).abs().mean() + 1e-3 * log.square()

    @property
    def gains(self) -> dict[str, float]:
        return {name: float(self.logs[number].detach().exp()) for name, number in self.numbers.items()}


# -- depth maps ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class DepthMapsConfig(LossConfig):
    weight: float = 4.0
    folder: str = ""

    def build(self) -> "DepthMaps":
        return DepthMaps(Path(self.folder))


class DepthMaps(ImageLoss):
    """Absolute difference of depth (object units), where a map VIEW.npy says it."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.seen: set[str] = set()

    def __call__(self, rendering: Rendering, target: Target) -> Tensor:
        depth = torch.from_numpy(np.load(self._folder / f"{target.name}.npy"))
        known = torch.isfinite(depth) & (rendering.alpha.detach() > 0.9)
        self.seen.add(target.name)
        # Weights count in both: else less coverage would pass for less depth.
        found = rendering.depth / rendering.alpha.clamp_min(1e-6)
        return (found - depth)[known].abs().sum() / depth.numel()


Named = Callable[[type[LossConfig], str], None]


@pytest.fixture
def named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Named:
    """Names for classes of this file, by the entry points of packages that are installed for one test."""

    def give(kind: type[LossConfig], name: str) -> None:
        site = tmp_path / f"site-{name}"
        folder = site / f"of_others_{name}-1.0.dist-info"
        folder.mkdir(parents=True)
        (folder / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: of-others-{name}\nVersion: 1.0\n", encoding="utf-8"
        )
        value = f"{kind.__module__}:{kind.__qualname__}"
        (folder / "entry_points.txt").write_text(
            f"[{registry.SLOTS['losses'].group}]\n{name} = {value}\n", encoding="utf-8"
        )
        monkeypatch.syspath_prepend(site)

    return give


def run(config: SculptingConfig, scene: sculpt.Scene, **more: object) -> sculpt.Session:
    session = sculpt.Session(scene, config, **more)  # pyright: ignore[reportArgumentType]
    session.run()
    return session


def term_of(session: sculpt.Session, kind: type) -> ImageLoss:
    return next(each.term for each in method_of(session).trainer.objectives.images if isinstance(each.term, kind))


@pytest.fixture(scope="module")
def scene() -> sculpt.Scene:
    return small_scene(views=8)


def dimmed(scene: sculpt.Scene) -> tuple[sculpt.Scene, Mapping[str, float]]:
    """Each photograph times a gain of its own, and these."""
    gains = [0.6, 0.8, 1.0, 0.7, 0.9, 0.65, 1.0, 0.75]
    views = tuple(replace(view, rgb=view.rgb * gain) for view, gain in zip(scene.train, gains, strict=True))
    return replace(scene, train=views), {view.name: gain for view, gain in zip(views, gains, strict=True)}


def exposed(steps: int = 24, **changes: object) -> SculptingConfig:
    losses = (ExposureConfig(), SilhouetteConfig(), EikonalConfig())
    base = small_method(steps, losses=losses, holdout_every=0, random_background=False, **changes)
    return replace(base, trainer=replace(base.trainer, stages=(STAGE,)))


@pytest.mark.slow
def test_an_exposure_is_learned_for_each_image(scene: sculpt.Scene, named: Named):
    named(ExposureConfig, "exposure")
    dim, gains = dimmed(scene)
    learned = term_of(run(exposed(60), dim), Exposure)
    assert isinstance(learned, Exposure)
    found = np.array([learned.gains[name] for name in gains])
    wanted = np.array([*gains.values()])
    # Up to one factor for all, which colours may take as well.
    errors = np.log(found / wanted) - np.log(found / wanted).mean()
    assert np.log(wanted).std() > 0.15
    assert np.abs(errors).max() < 0.06


@pytest.mark.slow
def test_it_is_kept_and_resumed(scene: sculpt.Scene, named: Named, tmp_path: Path):
    named(ExposureConfig, "exposure")
    dim, _ = dimmed(scene)
    config = exposed(8)
    whole = term_of(run(config, dim), Exposure)
    kept: list[tuple[dict[str, Tensor], Progress]] = []
    session = sculpt.Session(dim, config, save_state=lambda state, progress: kept.append((dict(state), progress)))
    for report in session:
        if report.step == 3:
            session.stop()
    write_checkpoint(tmp_path, *kept[-1])
    saved = read_checkpoint(tmp_path)
    assert saved[0]["terms/value.0"].shape == (8,)
    resumed = term_of(run(config, dim, saved=saved), Exposure)
    assert isinstance(whole, Exposure)
    assert isinstance(resumed, Exposure)
    assert torch.equal(whole.logs, resumed.logs)


def test_a_term_that_only_sees_images_teaches_no_colours(scene: sculpt.Scene, named: Named, tmp_path: Path):
    named(DepthMapsConfig, "depth-maps")
    losses = (DepthMapsConfig(folder=str(tmp_path)), SilhouetteConfig())
    with pytest.raises(ConfigError, match="no term that Gaussians learn colours from; add photometric"):
        sculpt.Session(scene, small_method(4, losses=losses))


@pytest.mark.slow
def test_depth_maps_alone_pull_a_ball_onto_the_object(named: Named, tmp_path: Path):
    named(DepthMapsConfig, "depth-maps")
    scene, truth = small_scene("blob", views=8), truth_of(demo_object("blob"))
    # Colours teach the surface nothing, and there is no silhouette loss.
    losses = (PhotometricConfig(weight=0.0), EikonalConfig())
    base = small_method(40, holdout_every=0, losses=losses, initializer=SphereConfig(fill=0.4))
    stages = (replace(STAGE, inner_steps=0, outer_views=4),)
    fast = replace(base.field, rate=0.02)  # pyright: ignore[reportCallIssue]
    base = replace(base, field=fast, trainer=replace(base.trainer, stages=stages, polish_steps=0))
    write_depths(truth, scene, tmp_path)
    without = error_of(run(base, scene), truth)
    session = run(replace(base, losses=(*losses, DepthMapsConfig(folder=str(tmp_path)))), scene)
    taught = term_of(session, DepthMaps)
    assert isinstance(taught, DepthMaps)
    assert taught.seen == {view.name for view in scene.train}
    assert error_of(session, truth) < 0.4 * without


def write_depths(truth: MeasuredMesh, scene: sculpt.Scene, folder: Path) -> None:
    """The truth's depth in the images of the stage, in object units."""
    images = prepare_images(scene.train, scene.box, STAGE.image_scale, torch.device("cpu"))
    local = scene.box.to_object(torch.from_numpy(truth.mesh.vertices)).numpy()
    for image in images:
        np.save(folder / f"{image.name}.npy", draw_mesh(local, truth.mesh.faces, image.camera).depth)


def error_of(session: sculpt.Session, truth: MeasuredMesh) -> float:
    mesh = session.mesh()
    squared, _ = truth.squared_distances(mesh.vertices.astype(np.float64))
    return float(np.sqrt(squared).mean())


def test_names_of_views_are_told(scene: sculpt.Scene, named: Named):
    named(ExposureConfig, "exposure")
    term = term_of(run(exposed(4), scene), Exposure)
    assert isinstance(term, Exposure)
    assert list(term.numbers) == [view.name for view in scene.train]
    assert all(a != b for a, b in itertools.pairwise(term.gains.values()))
