"""What a still background shows of a gap, and what it must not decide."""

import cv2
import numpy as np
import pytest
import torch

from sculpt_framework.posed_images.grab_cut import RoughCut, background_of, cut_along
from sculpt_framework.posed_images.still_background import with_still_background
from sculpt_framework.types import Camera

HEIGHT, WIDTH, COUNT = 80, 160, 12
WALL = cv2.resize(
    np.random.default_rng(7).integers(90, 170, (8, 16, 3)).astype(np.float32),
    (WIDTH, HEIGHT),
    interpolation=cv2.INTER_CUBIC,
)
"""Uneven, but smooth: colours alone hardly tell where it is seen through a gap."""


def camera(degrees: float) -> Camera:
    turn = cv2.Rodrigues(np.array([0.0, np.radians(degrees), 0.0]))[0]
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.from_numpy(turn)
    pose[2, 3] = 3.0
    return Camera(world_to_camera=pose, fx=100.0, fy=100.0, cx=80.0, cy=40.0, width=WIDTH, height=HEIGHT)


def turned(step: float) -> list[Camera]:
    return [camera(step * number) for number in range(COUNT)]


def left_of(number: int) -> int:
    return 16 + 8 * number


def shape(number: int) -> np.ndarray:
    """A block that swings to and fro, with a slit of four pixels."""
    left = left_of(number)
    out = np.zeros((HEIGHT, WIDTH), bool)
    out[15:65, left : left + 40] = True
    out[30:40, left + 10 : left + 14] = False
    return out


def cuts(*, walls: list[np.ndarray] | None = None, looks: np.ndarray | None = None) -> list[RoughCut]:
    """Rough outlines without the slit, of which all but a strip of three pixels is taken to be known."""
    noise = np.random.default_rng(0)
    marble = noise.integers(60, 220, (HEIGHT, WIDTH, 3)).astype(np.float32) if looks is None else looks
    out = []
    for number in range(COUNT):
        behind = WALL if walls is None else walls[number]
        image = np.where(shape(number)[..., None], np.roll(marble, 5 * number, axis=1), behind)
        image = (image + noise.integers(-1, 2, image.shape)).clip(0, 255).astype(np.uint8)
        solid = np.zeros((HEIGHT, WIDTH), np.uint8)
        solid[15:65, left_of(number) : left_of(number) + 40] = 1
        around = np.ones((7, 7), np.uint8)
        trimap = np.where(cv2.dilate(solid, around) > 0, cv2.GC_PR_BGD, cv2.GC_BGD)
        trimap = np.where(solid > 0, cv2.GC_PR_FGD, trimap)
        trimap = np.where(cv2.erode(solid, around) > 0, cv2.GC_FGD, trimap).astype(np.uint8)
        out.append(RoughCut(image=image, trimap=trimap, doubtful=np.zeros_like(solid, bool)))
    return out


def slit(number: int) -> tuple[slice, slice]:
    return slice(31, 39), slice(left_of(number) + 11, left_of(number) + 13)


def unchanged(before: list[RoughCut], cameras: list[Camera]) -> bool:
    pairs = zip(before, with_still_background(before, cameras), strict=True)
    return all(np.array_equal(old.trimap, new.trimap) for old, new in pairs)


def test_a_wall_is_seen_through_a_slit_that_depths_have_closed():
    before = cuts()
    after = with_still_background(before, turned(10))
    for number, (old, new) in enumerate(zip(before, after, strict=True)):
        assert (old.trimap[slit(number)] == cv2.GC_FGD).all()
        assert (new.trimap[slit(number)] == cv2.GC_BGD).mean() > 0.9
        found = cut_along(new, background_of(after))
        truth = shape(number)
        by_colours = cut_along(old, background_of(before))
        assert by_colours[slit(number)].all()
        assert not found[slit(number)].any()
        assert (found ^ truth).sum() < (by_colours ^ truth).sum()


def test_what_hides_the_wall_is_the_object():
    for number, each in enumerate(with_still_background(cuts(), turned(10))):
        edge = shape(number) & ~(cv2.erode(shape(number).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
        assert (each.trimap[edge] != cv2.GC_BGD).all()
        inner = cv2.erode(shape(number).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        assert (each.trimap[inner] == cv2.GC_FGD).mean() > 0.9


def test_a_background_that_moves_decides_nothing():
    assert unchanged(cuts(walls=[np.roll(WALL, 9 * number, axis=1) for number in range(COUNT)]), turned(10))


def test_cameras_that_hardly_move_decide_nothing():
    assert unchanged(cuts(), turned(0.5))


@pytest.mark.parametrize("grey", [0, 255])
def test_plain_surroundings_decide_nothing(grey: int):
    assert unchanged(cuts(walls=[np.full_like(WALL, grey)] * COUNT), turned(10))


def test_an_object_that_looks_like_the_wall_behind_it_loses_nothing():
    """What hides the wall may still be told: nothing does where the two are the same."""
    before = cuts(looks=WALL)
    camouflaged = [np.where(shape(number)[..., None], WALL, each.image) for number, each in enumerate(before)]
    before = [
        RoughCut(image=image.astype(np.uint8), trimap=each.trimap, doubtful=each.doubtful)
        for image, each in zip(camouflaged, before, strict=True)
    ]
    after = with_still_background(before, turned(10))
    for old, new in zip(before, after, strict=True):
        assert (new.trimap[old.trimap == cv2.GC_FGD] == cv2.GC_FGD).all()


def test_two_heights_of_the_camera_are_two_backgrounds():
    low, high = cuts(), cuts(walls=[np.flip(WALL, axis=(0, 1))] * COUNT)
    after = with_still_background([*low, *high], turned(10) * 2)
    seen = [(each.trimap[slit(number % COUNT)] == cv2.GC_BGD).mean() for number, each in enumerate(after)]
    assert np.mean(seen[:COUNT]) > 0.9
    assert np.mean(seen[COUNT:]) > 0.9


def test_a_view_without_the_object_and_one_of_another_size_are_no_trouble():
    some = cuts()
    empty = RoughCut(
        image=WALL.astype(np.uint8), trimap=np.full((HEIGHT, WIDTH), cv2.GC_BGD, np.uint8), doubtful=some[0].doubtful
    )
    # The images that are compared first are of 160 pixels: there a column less makes no difference.
    wide = [larger(each, WIDTH * 2) for each in some]
    other = larger(some[1], WIDTH * 2 - 1)
    after = with_still_background([*wide, larger(empty, WIDTH * 2), other], [*turned(10), camera(0), camera(10)])
    assert (after[COUNT].trimap == cv2.GC_BGD).all()
    assert np.array_equal(after[COUNT + 1].trimap, other.trimap)
    rows, columns = slit(0)
    inner = after[0].trimap[2 * rows.start : 2 * rows.stop, 2 * columns.start : 2 * columns.stop]
    assert (inner == cv2.GC_BGD).mean() > 0.9


def larger(cut: RoughCut, width: int) -> RoughCut:
    size = width, 2 * HEIGHT
    image, trimap, doubtful = (
        np.asarray(cv2.resize(layer, size, interpolation=cv2.INTER_NEAREST))
        for layer in (cut.image, cut.trimap, cut.doubtful.astype(np.uint8))
    )
    return RoughCut(image=image, trimap=trimap, doubtful=doubtful > 0)
