"""Scenes that a reconstruction can hardly be made of: few, wrong or useless pictures, objects of awkward shape."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import torch
from torch import Tensor

from sculpt_framework import registry
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.distance import Points, Values, box, capsule, smooth_difference, sphere
from sculpt_framework.demo_scenes.objects import DemoObject, demo_object
from sculpt_framework.errors import SculptError, TrainingFailed
from sculpt_framework.plan.agreement import by_agreement
from sculpt_framework.posed_images.outvoted import without_outvoted
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.stress.cases import Case, Measured
from sculpt_framework.stress.small import PIXELS, VIEWS, chamfer, scene_of, small_method, train, truth_of
from sculpt_framework.types import Box, Camera, Scene, View

_LIT_PIXELS = 96
"""Of images in which windows of seven pixels are compared."""
_LOST = 50.0
"""Chamfer distance, 1e-2 units, at which a result has nothing to do with an object of about one unit."""

Spoil = Callable[[int, View], View]


@dataclass(frozen=True, kw_only=True)
class Extreme:
    """A scene and what should come of it."""

    name: str
    done: str
    make: Callable[[], Scene]
    item: DemoObject
    limit: float
    """Chamfer distance, 1e-2 units."""
    expected: str = "a closed finite mesh"
    may_refuse: bool = False
    """One line that says what is wrong with the input will do as well."""
    method: Callable[[], SculptingConfig] = small_method


def scene_cases() -> Iterator[Case]:
    for extreme in (*_few_views(), *_poses(), *_masks(), *_colours(), *_lights(), *_shapes(), _large_images()):
        yield Case(
            id=f"scene-{extreme.name}",
            group="scenes",
            done=extreme.done,
            expected=extreme.expected + (", or one line on the input" if extreme.may_refuse else ""),
            unit="Chamfer distance, 1e-2",
            limit=extreme.limit,
            measure=partial(_measured, extreme),
        )


def _measured(extreme: Extreme) -> Measured:
    try:
        outcome = train(extreme.method(), extreme.make())
    except (SculptError, TrainingFailed) as error:
        one_line = "\n" not in str(error)
        return Measured(value=0.0 if extreme.may_refuse and one_line else math.inf, note=f"refused: {error}")
    if not outcome.sound:
        return Measured(value=math.nan, note="the mesh is not closed")
    recoveries = len(outcome.of("recovered"))
    notes = [f"{recoveries} recoveries"] if recoveries else []
    notes += [f"stopped: {outcome.failure}"] if outcome.failure else []
    return Measured(value=100.0 * chamfer(outcome, truth_of(extreme.item)), note="; ".join(notes))


# ------------------------------------------------------------------------------------------------------------- pictures


def _few_views() -> Iterator[Extreme]:
    blob = demo_object("blob")
    for count in (1, 2, 3):
        yield Extreme(
            name=f"views-{count}",
            done=f"{count} view{'s' if count > 1 else ''}",
            make=partial(_scene, blob, tuple(demo_cameras(count, PIXELS))),
            item=blob,
            limit=_LOST,
        )
    ahead = tuple(demo_cameras(VIEWS, PIXELS, placement="front"))
    yield Extreme(
        name="one-side",
        done="all cameras on one side",
        make=partial(_scene, blob, ahead),
        item=blob,
        limit=_LOST,
    )


def _poses() -> Iterator[Extreme]:
    for name, done, degrees, which in (
        ("pose-one-wrong", "one of 12 cameras turned by 40 degrees round the object", 40.0, (3,)),
        ("poses-noisy", "all cameras turned by about 2 degrees at random", 2.0, tuple(range(VIEWS))),
        ("poses-inconsistent", "all cameras turned by about 0.3 degrees at random", 0.3, tuple(range(VIEWS))),
    ):
        yield _spoilt(name, done, partial(_turned_view, degrees, which), _LOST if len(which) == 1 else 15.0)
    yield _spoilt("camera-inside", "one of 12 cameras stands in the middle of the object", _from_inside, _LOST)
    yield _spoilt("focal-inconsistent", "focal lengths off by 1 % in turn", _other_focal, 10.0)


def _masks() -> Iterator[Extreme]:
    yield _spoilt("masks-holes", "a hole of 8 x 8 pixels in the middle of every mask", _hole, _LOST, may_refuse=True)
    yield _spoilt("mask-one-wrong", "one mask shows another object", _other_mask, 3.0)
    yield _spoilt("mask-one-empty", "one mask is empty", partial(_set_mask, 0.0, (4,)), _LOST, may_refuse=True)
    yield _spoilt("masks-all-empty", "all masks are empty", partial(_set_mask, 0.0, None), _LOST, may_refuse=True)
    yield _spoilt("masks-all-full", "all masks cover the whole image", partial(_set_mask, 1.0, None), math.inf)


def _colours() -> Iterator[Extreme]:
    for name, done, paint in (
        ("black", "all black", lambda rgb, index: 0.0 * rgb),
        ("white", "all white", lambda rgb, index: 0.0 * rgb + 1.0),
        ("textureless", "one grey", lambda rgb, index: 0.0 * rgb + 0.5),
        ("mirror", "colours that differ from view to view", _mirrored),
        ("checkerboard", "a checkerboard of single pixels", _checkered),
        ("over-exposed", "twice the brightness, clipped", lambda rgb, index: (2.0 * rgb).clamp(max=1.0)),
        ("eight-levels", "8 levels of brightness", lambda rgb, index: (7.0 * rgb).round() / 7.0),
    ):
        yield _spoilt(f"colour-{name}", done, partial(_painted, paint), 10.0)


def _spoilt(name: str, done: str, spoil: Spoil, limit: float, may_refuse: bool = False) -> Extreme:
    blob = demo_object("blob")
    return Extreme(
        name=name, done=done, make=partial(_spoilt_scene, spoil), item=blob, limit=limit, may_refuse=may_refuse
    )


@lru_cache(maxsize=1)
def _plain() -> Scene:
    return _scene(demo_object("blob"), tuple(demo_cameras(VIEWS, PIXELS)))


def _scene(item: DemoObject, cameras: tuple[Camera, ...]) -> Scene:
    return scene_of(item, cameras)


def _spoilt_scene(spoil: Spoil) -> Scene:
    """With the views that a dataset would keep."""
    scene = _plain()
    kept, _ = without_outvoted([spoil(index, view) for index, view in enumerate(scene.train)], scene.box)
    return replace(scene, train=tuple(kept))


def _turned_view(degrees: float, which: tuple[int, ...], index: int, view: View) -> View:
    if index not in which:
        return view
    axis = np.random.default_rng(index).normal(size=3)
    axis *= math.radians(degrees) / np.linalg.norm(axis)
    x, y, z = axis
    cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
    pose = view.camera.world_to_camera.clone()
    pose[:3, :3] = pose[:3, :3] @ torch.matrix_exp(cross)
    return replace(view, camera=replace(view.camera, world_to_camera=pose))


def _from_inside(index: int, view: View) -> View:
    if index != 3:
        return view
    assert view.alpha is not None  # noqa: S101 - demo views have masks
    camera = replace(view.camera, world_to_camera=torch.eye(4, dtype=view.camera.world_to_camera.dtype))
    return replace(view, camera=camera, rgb=torch.full_like(view.rgb, 0.4), alpha=torch.ones_like(view.alpha))


def _other_focal(index: int, view: View) -> View:
    factor = 1.01 if index % 2 else 0.99
    return replace(view, camera=replace(view.camera, fx=factor * view.camera.fx, fy=factor * view.camera.fy))


def _hole(index: int, view: View) -> View:
    assert view.alpha is not None  # noqa: S101 - demo views have masks
    alpha, middle = view.alpha.clone(), PIXELS // 2
    alpha[middle - 4 : middle + 4, middle - 4 : middle + 4] = 0.0
    return replace(view, alpha=alpha)


def _other_mask(index: int, view: View) -> View:
    assert view.alpha is not None  # noqa: S101 - demo views have masks
    return replace(view, alpha=view.alpha.flip(0, 1).roll(9, 0)) if index == 4 else view


def _set_mask(value: float, which: tuple[int, ...] | None, index: int, view: View) -> View:
    assert view.alpha is not None  # noqa: S101 - demo views have masks
    return replace(view, alpha=torch.full_like(view.alpha, value)) if which is None or index in which else view


def _painted(paint: Callable[[Tensor, int], Tensor], index: int, view: View) -> View:
    return replace(view, rgb=paint(view.rgb, index))


def _mirrored(rgb: Tensor, index: int) -> Tensor:
    """Stripes of another colour and direction in each view: nothing agrees between two of them."""
    generator = np.random.default_rng(index)
    rows, columns = torch.meshgrid(torch.arange(rgb.shape[0]), torch.arange(rgb.shape[1]), indexing="ij")
    along = torch.tensor(generator.normal(size=2) * 0.4)
    stripes = 0.5 + 0.5 * torch.sin(along[0] * rows + along[1] * columns)
    return (stripes[..., None] * torch.tensor(generator.uniform(size=3))).to(rgb)


def _checkered(rgb: Tensor, index: int) -> Tensor:
    rows, columns = torch.arange(rgb.shape[0])[:, None], torch.arange(rgb.shape[1])[None]
    return ((rows + columns) % 2).to(rgb)[..., None].expand_as(rgb).contiguous()


# ---------------------------------------------------------------------------------------------------------------- light


def _lights() -> Iterator[Extreme]:
    """By agreement between photographs, which is what surfaces learn from where light differs."""
    blob = demo_object("blob")
    for name, done, paint in (
        ("even", "as it is, for comparison", lambda rgb, index: rgb),
        ("black-and-white", "black and white images", lambda rgb, index: rgb.mean(dim=2, keepdim=True).expand_as(rgb)),
        ("exposures", "every second image four times as bright as the others, clipped", _exposed),
        ("moving-shadow", "a shadow over half of every third image, another half in each", _shaded),
        ("identical", "the same picture in all views, in their own masks", _first_picture),
    ):
        yield Extreme(
            name=f"light-{name}",
            done=f"by agreement: {done}",
            make=partial(_lit_scene, VIEWS, paint),
            item=blob,
            limit=10.0,
            method=_agreeing,
        )
    yield Extreme(
        name="light-one-view",
        done="by agreement: one view, which has nothing to agree with",
        make=partial(_lit_scene, 1, lambda rgb, index: rgb),
        item=blob,
        limit=_LOST,
        method=_agreeing,
    )


def _agreeing() -> SculptingConfig:
    config = small_method()
    parts = (*config.losses, registry.default("losses", "consistency"))
    return by_agreement(replace(config, losses=parts))  # pyright: ignore[reportArgumentType]


@lru_cache(maxsize=1)
def _lit() -> Scene:
    return _scene(demo_object("blob"), tuple(demo_cameras(VIEWS, _LIT_PIXELS)))


def _lit_scene(count: int, paint: Callable[[Tensor, int], Tensor]) -> Scene:
    views = _lit().train[:count]
    return replace(_lit(), train=tuple(_painted(paint, index, view) for index, view in enumerate(views)))


def _exposed(rgb: Tensor, index: int) -> Tensor:
    return ((2.0 if index % 2 else 0.5) * rgb).clamp(max=1.0)


def _shaded(rgb: Tensor, index: int) -> Tensor:
    if index % 3:
        return rgb
    columns, rows = torch.linspace(-1, 1, rgb.shape[1]), torch.linspace(-1, 1, rgb.shape[0])[:, None]
    across = columns * math.cos(index) + rows * math.sin(index)
    return rgb * (0.7 - 0.3 * torch.tanh(20 * across))[..., None].to(rgb)


def _first_picture(rgb: Tensor, index: int) -> Tensor:
    return _lit().train[0].rgb


# --------------------------------------------------------------------------------------------------------------- shapes


def _shapes() -> Iterator[Extreme]:
    for name, done, distance, limit in (
        ("filling", "a cube that fills the box to 2 %", partial(_cube, 0.55), 10.0),
        ("one-percent", "a ball in 1 % of the box's volume", partial(_ball, 0.27), 10.0),
        ("two-objects", "two balls that do not touch", _two_balls, 10.0),
        ("sheet", "a sheet of 1 % of the box's width, a fourteenth of a cell", _sheet, 15.0),
        ("genus-20", "a plate with 20 holes", _holed_plate, 25.0),
    ):
        item = replace(demo_object("blob"), name=name, distance=distance)
        half = 0.56 if name == "filling" else 1.0
        yield Extreme(name=f"shape-{name}", done=done, make=partial(_shape_scene, item, half), item=item, limit=limit)


def _shape_scene(item: DemoObject, half_side: float) -> Scene:
    corner = torch.full((3,), half_side)
    scene = scene_of(item, demo_cameras(VIEWS, PIXELS))
    return replace(scene, box=Box(minimum=-corner, maximum=corner))


def _cube(half_side: float, p: Points) -> Values:
    return box(p, (0.0, 0.0, 0.0), (half_side, half_side, half_side), 0.01)


def _ball(radius: float, p: Points) -> Values:
    return sphere(p, (0.2, -0.1, 0.15), radius)


def _two_balls(p: Points) -> Values:
    return np.minimum(sphere(p, (-0.5, 0.0, 0.0), 0.35), sphere(p, (0.5, 0.1, 0.1), 0.3))


def _sheet(p: Points) -> Values:
    return box(p, (0.0, 0.0, 0.0), (0.6, 0.6, 0.01), 0.009)


def _holed_plate(p: Points) -> Values:
    plate = box(p, (0.0, 0.0, 0.0), (0.7, 0.6, 0.09), 0.03)
    # Four rows of five: the nearest hole is found by folding.
    x = p[0] - 0.26 * np.clip(np.round(p[0] / 0.26), -2, 2)
    y = p[1] - 0.28 * (np.clip(np.floor(p[1] / 0.28), -2, 1) + 0.5)
    return smooth_difference(plate, capsule(np.stack([x, y, p[2]]), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 0.075), 0.02)


# --------------------------------------------------------------------------------------------------------- large images


def _large_images() -> Extreme:
    blob = demo_object("blob")
    return Extreme(
        name="images-4000x3000",
        done="three images of 4000 x 3000 pixels, trained at a fiftieth of that",
        make=partial(_enlarged, 4000, 3000),
        item=blob,
        limit=_LOST,
        method=_at_a_fiftieth,
    )


def _enlarged(width: int, height: int) -> Scene:
    views = []
    for view in _scene(demo_object("blob"), tuple(demo_cameras(3, 60))).train:
        assert view.alpha is not None  # noqa: S101 - demo views have masks
        pixels = torch.cat([view.rgb, view.alpha[..., None]], dim=2).permute(2, 0, 1)[None]
        large = torch.nn.functional.interpolate(pixels, (height, width), mode="bilinear", align_corners=False)[0]
        views.append(
            View(
                name=view.name,
                camera=view.camera.resized(width, height),
                rgb=large[:3].permute(1, 2, 0).contiguous(),
                alpha=large[3],
            )
        )
    return replace(_plain(), train=tuple(views))


def _at_a_fiftieth() -> SculptingConfig:
    config = small_method()
    stages = tuple(replace(stage, image_scale=0.02) for stage in config.trainer.stages)
    return replace(config, trainer=replace(config.trainer, stages=stages))
