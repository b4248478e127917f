"""One wrong mask, or pose, among many must not cut its part off the object."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
import torch

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.posed_images.outvoted import FEWEST, without_outvoted
from sculpt_framework.stress.small import view_of
from sculpt_framework.types import View

Spoil = Callable[[View], View]


@pytest.fixture(scope="module")
def views() -> list[View]:
    item = demo_object("blob")
    return [view_of(item, camera, f"r_{number}") for number, camera in enumerate(demo_cameras(20, 64))]


def masked(view: View, keep: torch.Tensor) -> View:
    assert view.alpha is not None
    return replace(view, alpha=view.alpha * keep)


def half_erased(view: View) -> View:
    return masked(view, (torch.arange(view.camera.width) < view.camera.width // 2).float()[None])


def enlarged(view: View) -> View:
    """By a shadow beside the object."""
    assert view.alpha is not None
    return replace(view, alpha=torch.maximum(view.alpha, view.alpha.roll(14, 1)))


def upside_down(view: View) -> View:
    assert view.alpha is not None
    return replace(view, alpha=view.alpha.flip(0, 1).roll(12, 0))


def turned(view: View, degrees: float = 40.0) -> View:
    """Its camera, round the object."""
    angle = math.radians(degrees)
    pose = view.camera.world_to_camera.clone()
    turn = torch.tensor([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    pose[:3, :3] = pose[:3, :3] @ turn.to(pose)
    return replace(view, camera=replace(view.camera, world_to_camera=pose))


def spoilt(views: Sequence[View], which: Sequence[int], spoil: Spoil) -> list[View]:
    return [spoil(view) if number in which else view for number, view in enumerate(views)]


def left_out(views: Sequence[View]) -> tuple[set[int], list[str]]:
    kept, notes = without_outvoted(views, fit_box(views).box)
    names = {view.name for view in kept}
    return {number for number, view in enumerate(views) if view.name not in names}, notes


def test_all_stay_where_all_agree(views: list[View]):
    assert left_out(views) == (set(), [])


@pytest.mark.parametrize("spoil", [half_erased, enlarged, upside_down])
@pytest.mark.parametrize("which", [(7,), (0, 4, 13)])
def test_those_that_cut_a_part_off_are_left_out_and_named(views: list[View], spoil: Spoil, which: Sequence[int]):
    wrong, (note,) = left_out(spoilt(views, which, spoil))
    assert wrong == set(which)
    assert all(f"r_{number}" in note for number in which)


@pytest.mark.slow
def test_so_is_one_whose_camera_is_wrong():
    """Of an object that looks otherwise from there: a ball does not tell."""
    item = demo_object("machine")
    views = [view_of(item, camera, f"r_{number}") for number, camera in enumerate(demo_cameras(20, 64))]
    assert left_out(views) == (set(), [])
    wrong, notes = left_out(spoilt(views, (3,), turned))
    assert wrong == {3}
    assert "contradicts the others" in notes[0]


def test_where_half_of_them_are_wrong_nobody_is_blamed(views: list[View]):
    wrong, notes = left_out(spoilt(views, range(0, 20, 2), half_erased))
    assert wrong == set()
    assert "which cannot be told" in notes[0]


def test_poses_that_are_all_a_little_off_are_kept(views: list[View]):
    noisy = [turned(view, 0.5 if number % 2 else -0.5) for number, view in enumerate(views)]
    assert left_out(noisy) == (set(), [])


def test_few_views_know_nothing_of_each_other(views: list[View]):
    few = spoilt(views[: FEWEST - 1], (2,), half_erased)
    assert left_out(few) == (set(), [])


def test_views_without_masks_are_not_asked(views: list[View]):
    some = [replace(view, alpha=None) if number % 2 else view for number, view in enumerate(views)]
    wrong, _ = left_out(spoilt(some, (4,), half_erased))
    assert wrong == {4}
