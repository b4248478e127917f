"""Photographs that something is wrong with: the object is found all the same, or one line says why not."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
import torch

from sculpt_framework.posed_images.find_object import FoundObject, find_object
from sculpt_framework.types import View
from tests.datasets.test_find_object import SEED, SIDE, BallAlone, OnTable, overlaps, ring

pytestmark = pytest.mark.slow
Change = Callable[[list[View]], list[View]]
_SANE = 0.75
"""Intersection over union with the truth, mean over the images, of a mask that may be called one of the object."""


@dataclass(frozen=True, kw_only=True)
class Two(OnTable):
    """Two balls side by side."""

    def ball(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        apart = np.array([0.32, 0.17, 0.0])
        small = OnTable(radius=0.28)
        left, right = (OnTable.ball(small, origin + side * apart, rays) for side in (1, -1))
        return np.minimum(left, right)


@dataclass(frozen=True, kw_only=True)
class TwoAlone(Two):
    def hit(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        return self.ball(origin, rays)


@pytest.fixture(scope="module")
def views() -> list[View]:
    return ring(OnTable())


@pytest.fixture(scope="module")
def truth() -> list[View]:
    return ring(BallAlone(), masked=True)


def _each(change: Callable[[View, int], torch.Tensor]) -> Change:
    return lambda views: [replace(view, rgb=change(view, index).clamp(0, 1)) for index, view in enumerate(views)]


def _moving(view: View, index: int) -> torch.Tensor:
    """Something else behind table and ball in each image."""
    noise = np.random.default_rng(index).random((10, 10, 3)).astype(np.float32)
    behind = torch.from_numpy(cv2.resize(noise, view.rgb.shape[1::-1], interpolation=cv2.INTER_LINEAR))
    return torch.where(view.rgb == 0, behind, view.rgb)


def _blurred(view: View, index: int) -> torch.Tensor:
    return torch.from_numpy(cv2.GaussianBlur(view.rgb.numpy(), (0, 0), 4)) if index % 2 else view.rgb


def _noisy(view: View, index: int) -> torch.Tensor:
    return view.rgb + 0.04 * torch.randn(view.rgb.shape, generator=torch.Generator().manual_seed(index))


def _turned(views: list[View]) -> list[View]:
    """The poses of another scene: every image has the camera of some other one."""
    order = np.random.default_rng(3).permutation(len(views))
    return [replace(view, camera=views[other].camera) for view, other in zip(views, order, strict=True)]


def _cut(views: list[View]) -> list[View]:
    """Images of the left half only."""
    out = []
    for view in views:
        camera = view.camera.crop(0, 0, view.camera.width // 2, view.camera.height)
        out.append(replace(view, camera=camera, rgb=view.rgb[:, : view.camera.width // 2]))
    return out


def _white_balance(view: View, index: int) -> torch.Tensor:
    return view.rgb * torch.from_numpy(np.random.default_rng(index).uniform(0.6, 1.3, 3).astype(np.float32))


def _vignetted(view: View, index: int) -> torch.Tensor:
    rows, columns = np.indices(view.rgb.shape[:2]) / SIDE - 0.5
    return view.rgb * torch.from_numpy((1 - rows**2 - columns**2).astype(np.float32))[..., None]


def _as_jpeg(view: View, index: int) -> torch.Tensor:
    _, coded = cv2.imencode(".jpg", (255 * view.rgb.numpy()).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 40])
    return torch.from_numpy(cv2.imdecode(coded, cv2.IMREAD_COLOR).astype(np.float32) / 255)


def _spotted(view: View, index: int) -> torch.Tensor:
    """Dirt on the lens, in the same place of each image."""
    rgb = view.rgb.clone()
    rgb[30:38, 40:48] = 0.1
    return rgb


def _lit_from_the_camera(view: View, index: int) -> torch.Tensor:
    """A shadow moves over the table and the ball."""
    columns = torch.arange(view.rgb.shape[1])
    shaded = (columns > 12 * (index % 6)) & (columns < 12 * (index % 6) + 30)
    return torch.where(shaded[None, :, None], 0.5 * view.rgb, view.rgb)


KEPT: dict[str, Change] = {
    "white balance of its own in each": _each(_white_balance),
    "corners darkened by the lens": _each(_vignetted),
    "coarse JPEG": _each(_as_jpeg),
    "dirt on the lens": _each(_spotted),
    "a shadow that moves": _each(_lit_from_the_camera),
    "every fourth black": _each(lambda view, i: view.rgb * float(i % 4 > 0)),
    "a channel that is clipped": _each(
        lambda view, i: torch.cat([torch.ones_like(view.rgb[..., :1]), view.rgb[..., 1:]], -1)
    ),
    "exposures from a half to one and a half": _each(lambda view, i: view.rgb * (0.5 + (i % 5) / 4)),
    "noise": _each(_noisy),
    "every other image blurred": _each(_blurred),
    "another background in each": _each(_moving),
    "colours turned round": _each(lambda view, i: 1 - view.rgb),
    "an image of another scene": lambda views: [replace(views[0], rgb=views[12].rgb), *views[1:]],
    "one image twice": lambda views: [*views, views[3]],
    "images of two sizes": lambda views: [_smaller(view) if i % 3 == 0 else view for i, view in enumerate(views)],
}


def _smaller(view: View) -> View:
    size = (view.camera.width // 2, view.camera.height // 2)
    rgb = torch.from_numpy(cv2.resize(view.rgb.numpy(), size, interpolation=cv2.INTER_AREA))
    return replace(view, camera=view.camera.resized(*size), rgb=rgb)


LOST: dict[str, Change] = {
    "mirrored": _each(lambda view, i: view.rgb.flip(1)),
    "upside down": _each(lambda view, i: view.rgb.flip(0).flip(1)),
    "one colour each": _each(lambda view, i: torch.full_like(view.rgb, 0.1 + 0.03 * i)),
    "poses of another scene": _turned,
    "black": _each(lambda view, i: torch.zeros_like(view.rgb)),
    "white": _each(lambda view, i: torch.ones_like(view.rgb)),
    "one image": lambda views: views[:1],
    "two images from opposite sides": lambda views: [views[0], views[12]],
    "the same image from everywhere": lambda views: [replace(view, rgb=views[0].rgb) for view in views],
    "all from one place": lambda views: [replace(view, camera=views[0].camera) for view in views],
}


@pytest.mark.parametrize("name", KEPT)
def test_it_is_found_all_the_same(name: str, views: list[View], truth: list[View]):
    changed = KEPT[name](views)
    found = find_object(changed, [], SEED)
    assert isinstance(found, FoundObject), found
    exact = [truth[int(view.name)] for view in found.train]
    full = [view for view in zip(found.train, exact, strict=True) if view[0].rgb.shape == view[1].rgb.shape]
    assert len(found.train) >= 0.9 * len(changed)
    assert np.mean(overlaps([view for view, _ in full], [view for _, view in full])) > _SANE


@pytest.mark.parametrize("name", LOST)
def test_it_is_said_that_it_is_not_found(name: str, views: list[View]):
    said = find_object(LOST[name](views), [], SEED)
    assert isinstance(said, str)


@pytest.mark.parametrize("count", [3, 6])
def test_few_views_tell_it_or_say_so(count: int, views: list[View], truth: list[View]):
    found = find_object(views[: 2 * count : 2], [], SEED)
    if isinstance(found, FoundObject):
        exact = [truth[int(view.name)] for view in found.train]
        assert np.mean(overlaps(found.train, exact)) > 0.6


def test_images_that_cut_the_object_show_a_part_of_it(views: list[View]):
    found = find_object(_cut(views), [], SEED, sure=True)
    assert isinstance(found, str) or all(view.alpha is not None for view in found.train)


def test_two_objects_are_both_taken():
    found = find_object(ring(Two()), [], SEED)
    assert isinstance(found, FoundObject), found
    assert np.mean(overlaps(found.train, ring(TwoAlone(), masked=True))) > 0.9
