"""Objects photographed from one side, behind which no silhouette says where they end."""

import numpy as np
from cameras_around import camera_from

from sculpt_framework.shape_from_images.closing import close_unseen
from sculpt_framework.shape_from_images.enclosing import enclosed, reaches_walls
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.types import Camera

CELLS = 48
CELL = 2.0 / CELLS


def volume(values: np.ndarray) -> Volume:
    shaped = values.reshape(CELLS, CELLS, CELLS).astype(np.float32)
    return Volume(values=shaped, origin=(-1.0, -1.0, -1.0), cell=CELL)


def centers() -> np.ndarray:
    return volume(np.zeros(CELLS**3)).points.astype(np.float64).T


def in_front(count: int) -> list[Camera]:
    """On the side of +x."""
    turn = np.linspace(-0.4, 0.4, count)
    return [camera_from((3 * np.cos(t), 3 * np.sin(t), 0.3), (200, 200)) for t in turn.tolist()]


def slab() -> Volume:
    """Its front is a roof, seen from +x, whose eaves stand at x = 0; behind it goes on to the wall."""
    x, y, z = centers()
    return volume(np.maximum(np.maximum(np.abs(y), np.abs(z)) - 0.5, x - 0.4 + 0.8 * np.abs(y)))


def deepest(shape: Volume) -> float:
    """The smallest x that is inside."""
    return float(centers()[0][shape.values.reshape(-1) < 0].min())


def test_what_goes_on_to_the_wall_is_closed_from_edge_to_edge():
    shape = slab()
    assert reaches_walls(shape)
    assert deepest(shape) < -0.9
    closed = close_unseen(shape, in_front(6))
    assert abs(deepest(closed)) < 3 * CELL
    assert not reaches_walls(closed)


def test_what_is_seen_stays():
    shape, closed = slab(), enclosed(slab(), in_front(6))
    x, y, _ = centers()
    front = ((x > 2 * CELL) & (np.abs(y) < 0.45)).reshape(shape.shape)
    assert ((closed.values < 0) == (shape.values < 0))[front].all()
    # Nothing is added.
    assert (shape.values < 0)[closed.values < 0].all()


def test_what_is_behind_a_camera_hides_nothing_from_it():
    x, _, _ = centers()
    cameras = [camera_from((0.85 * np.cos(t), 0.85 * np.sin(t), 0.1), (200, 200)) for t in (-0.3, 0.0, 0.3)]
    alone = slab()
    walled = volume(np.where(x > 0.95, np.minimum(alone.values.reshape(-1), 0.95 - x), alone.values.reshape(-1)))
    before = (x < 0.8).reshape(alone.shape)
    found = [(enclosed(shape, cameras).values < 0)[before] for shape in (alone, walled)]
    assert found[0].any()
    assert (found[0] == found[1]).all()


def test_what_stands_apart_and_no_two_images_show_goes():
    x, y, z = centers()
    far_off = np.maximum(np.maximum(np.abs(y), np.abs(z - 0.9)) - 0.08, np.abs(x - 0.2) - 0.3)
    narrow = [camera.crop(40, 60, 120, 80) for camera in in_front(6)]
    shape = volume(np.minimum(slab().values.reshape(-1), far_off))
    assert (shape.values < 0)[:, :, -4:].any()
    assert not (enclosed(shape, narrow).values < 0)[:, :, -4:].any()


def test_one_view_bounds_nothing():
    shape = slab()
    assert enclosed(shape, in_front(1)) is shape


def test_a_flat_front_has_a_volume():
    """All that is seen lies in one plane, of which alone there is no convex hull."""
    x, y, z = centers()
    shape = volume(np.maximum(np.maximum(np.abs(y), np.abs(z)) - 0.5, x))
    straight = [camera_from((3.0, y, 0.0), (200, 200)) for y in (-0.1, 0.1)]
    closed = enclosed(shape, straight)
    assert np.isfinite(closed.values).all()
    assert -4 * CELL < deepest(closed) < 0


def test_a_shape_that_silhouettes_bound_does_not_reach_the_walls():
    assert not reaches_walls(volume(np.linalg.norm(centers(), axis=0) - 0.8))
