"""Parts without depth, by colours that views agree on: a ball whose cap no depth is known of."""

import numpy as np
import pytest
import torch

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.posed_images.plain_parts import agreed, grown
from sculpt_framework.types import Camera, View

RADIUS, CAP, SIDE = 0.6, 0.52, 96


def ball(camera: Camera, spot: bool) -> tuple[View, np.ndarray, np.ndarray]:
    """A brown ball before grey, the whole mask, and what of it lies below the cap; with a brown spot beside it."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    rays = np.stack([(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy], axis=-1)
    rays = np.concatenate([rays, np.ones((SIDE, SIDE, 1))], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    pose = camera.world_to_camera.double().numpy()
    ways, place = rays @ pose[:3, :3], camera.position.double().numpy()
    along = ways @ place
    under = along**2 - place @ place + RADIUS**2
    whole = under > 0
    height = (place + (-along - np.sqrt(under.clip(0)))[..., None] * ways)[..., 2]
    noise = 0.02 * np.random.default_rng(3).normal(size=(SIDE, SIDE, 1))
    rgb = np.where(whole[..., None], (0.5, 0.3, 0.1), (0.6, 0.62, 0.65)) + noise
    if spot:
        row = int(np.median(np.flatnonzero(whole.any(axis=1))))
        column = np.flatnonzero(whole[row])[-1]
        rgb[row - 6 : row + 6, column : column + 7] = (0.5, 0.3, 0.1)
    view = View(name="v", camera=camera, rgb=torch.from_numpy(rgb).float().clamp(0, 1), alpha=None)
    return view, whole, whole & (height < CAP)


def test_a_cap_comes_back_and_a_spot_that_one_view_has_does_not():
    cameras = demo_cameras(16, SIDE)
    shots = [ball(camera, spot=number == 2) for number, camera in enumerate(cameras)]
    masks = grown([view for view, _, _ in shots], [known for _, _, known in shots])
    missing = [(whole & ~known).sum() for _, whole, known in shots]
    back = [(mask & whole & ~known).sum() for mask, (_, whole, known) in zip(masks, shots, strict=True)]
    assert sum(missing) > 300
    assert sum(back) > 0.8 * sum(missing), "all but what is farther than an outline may grow"
    assert all((mask & known).sum() == known.sum() for mask, (_, _, known) in zip(masks, shots, strict=True))
    first, whole = masks[2], shots[2][1]
    assert (first & ~whole).sum() > 30, "by itself, a view takes the spot"
    points = np.random.default_rng(0).uniform(-1, 1, (20_000, 3))
    inside = np.linalg.norm(points, axis=1)
    held = agreed(points, cameras, masks)
    # Where one view has not grown enough, nothing behind it is agreed upon; the known outlines stay in any case.
    cap = points[:, 2] > CAP
    assert held[(inside < 0.9 * RADIUS) & ~cap].mean() > 0.8
    assert held[(inside < 0.95 * RADIUS) & cap].mean() > 0.3
    assert held[inside > 1.15 * RADIUS].mean() < 0.01


def test_what_shows_nothing_and_what_fills_the_image_stay():
    view, _, known = ball(demo_cameras(4, SIDE)[0], spot=False)
    nothing, everything = np.zeros_like(known), np.ones_like(known)
    masks = grown([view, view], [nothing, everything])
    assert not masks[0].any()
    assert masks[1].all()
    behind = view.camera.position.double().numpy()[None] * 2
    assert agreed(behind, [view.camera], masks[1:]).tolist() == [False]


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_who_does_not_show_a_place_has_no_say(share: float):
    view, _, known = ball(demo_cameras(4, SIDE)[0], spot=False)
    others = round(4 * (1 / share - 1))
    cameras = [view.camera] * 4 + [view.camera.crop(0, 0, 4, 4)] * others
    held = agreed(np.zeros((1, 3)), cameras, [known] * 4 + [np.zeros((4, 4), bool)] * others)
    assert held.tolist() == [share > 0.5]
