"""Outlines decided by colours."""

import cv2
import numpy as np
import pytest
import torch

from sculpt_framework.posed_images.grab_cut import background_of, cut_along, learned_cut, rough_cut
from sculpt_framework.types import Camera, View

HEIGHT, WIDTH = 60, 120
OBJECT = np.zeros((HEIGHT, WIDTH), bool)
OBJECT[20:40, 40:60] = True


def picture(shape: np.ndarray = OBJECT) -> np.ndarray:
    """A red square before green, of which a part beside it is blue, all a little uneven; blue, green and red."""
    noise = np.random.default_rng(0).integers(-12, 13, (HEIGHT, WIDTH, 3))
    behind = np.where(np.arange(WIDTH)[:, None] > 60, (200, 120, 40), (40, 140, 60))
    return np.clip(np.where(shape[..., None], (40, 40, 200), behind) + noise, 0, 255).astype(np.uint8)


def test_what_is_to_be_decided_does_not_teach_that_it_is_the_object():
    """Most of what may be the object is sky, of which little is known to be background: else it would be most of what
    is learned of the object."""
    trimap = np.full((HEIGHT, WIDTH), cv2.GC_BGD, np.uint8)
    trimap[:, 36:118] = cv2.GC_PR_FGD
    trimap[24:36, 44:56] = cv2.GC_FGD
    found = learned_cut(picture(), trimap, 3)
    assert (found & OBJECT).sum() > 0.97 * OBJECT.sum()
    assert (found & ~OBJECT).sum() < 0.03 * OBJECT.sum()


def test_a_speck_of_the_object_is_enough_to_learn_from():
    trimap = np.full((HEIGHT, WIDTH), cv2.GC_BGD, np.uint8)
    trimap[18:42, 38:62] = cv2.GC_PR_FGD
    trimap[30, 50] = cv2.GC_FGD
    found = learned_cut(picture(), trimap, 3)
    assert found[30, 50]
    assert not found[:18].any()


def seen_at(rgb: np.ndarray) -> View:
    camera = Camera(
        world_to_camera=torch.eye(4, dtype=torch.float64),
        fx=100.0,
        fy=100.0,
        cx=60.0,
        cy=30.0,
        width=WIDTH,
        height=HEIGHT,
    )
    return View(name="", camera=camera, rgb=torch.from_numpy(rgb[:, :, ::-1].astype(np.float32) / 255), alpha=None)


def block(rows: slice, columns: slice) -> np.ndarray:
    out = np.zeros((HEIGHT, WIDTH), bool)
    out[rows, columns] = True
    return out


def assert_is_the_object(found: np.ndarray) -> None:
    assert found.shape == OBJECT.shape
    assert (found & OBJECT).sum() > 0.97 * OBJECT.sum()
    assert (found & ~OBJECT).sum() < 0.03 * OBJECT.sum()


def test_a_rough_outline_is_followed_to_the_edge_where_nothing_was_measured():
    rough = rough_cut(
        seen_at(picture()), block(slice(None), slice(38, 118)), block(slice(22, 38), slice(42, 58)), blind=False
    )
    assert_is_the_object(cut_along(rough, background_of([rough])))


def test_depths_beyond_an_edge_do_not_teach_that_what_is_beside_it_is_the_object():
    """What was measured reaches two pixels over the edge, as windows of depths do."""
    rough = rough_cut(
        seen_at(picture()), block(slice(None), slice(30, 118)), block(slice(18, 42), slice(38, 62)), blind=False
    )
    assert_is_the_object(cut_along(rough, background_of([rough])))


def test_a_view_without_a_background_of_its_own_learns_from_others():
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    filled = rough_cut(seen_at(picture()), everywhere, block(slice(22, 38), slice(42, 58)), blind=False)
    assert not background_of([filled]).size
    assert cut_along(filled, background_of([filled])).all()
    other = rough_cut(seen_at(picture()), OBJECT, OBJECT, blind=False)
    assert_is_the_object(cut_along(filled, background_of([filled, other])))


@pytest.mark.parametrize("uneven", [0, 12])
def test_an_outline_between_equal_colours_stays_where_depths_have_it(uneven: int):
    """A mat on a table of its colour: GrabCut gives all of what it may decide to one of the two."""
    noise = np.random.default_rng(0).integers(-uneven, uneven + 1, (HEIGHT, WIDTH, 3))
    even = np.clip(np.array((60, 90, 140)) + noise, 0, 255).astype(np.uint8)
    rough = rough_cut(seen_at(even), OBJECT, OBJECT, blind=False)
    found = cut_along(rough, background_of([rough]))
    # Of the corners, which a strip is rounded at, colours may take a little.
    assert (found != OBJECT).sum() < 0.02 * OBJECT.sum()


def test_an_object_goes_on_to_the_border_where_depths_end_before_it():
    whole, measured = block(slice(20, 60), slice(40, 60)), block(slice(20, 54), slice(40, 60))
    found = {}
    for blind in (False, True):
        rough = rough_cut(seen_at(picture(whole)), measured, measured, blind=blind)
        found[blind] = cut_along(rough, background_of([rough]))
    assert (found[True] & whole).sum() > 0.98 * whole.sum()
    assert (found[True] & ~whole).sum() < 0.03 * whole.sum()
    assert not found[False][57:].any()
