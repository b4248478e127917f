"""A ball whose hull is drawn out behind it, where nobody looks, into a cone."""

import numpy as np
from cameras_around import camera_from

from sculpt_framework.shape_from_images.closing import close_unseen
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.types import Camera

RADIUS = 0.6
DISTANCE = 1.2
"""Of the cameras: at two radii each sees a cap of 60 degrees."""
CELLS = 72


def volume(values: np.ndarray) -> Volume:
    return Volume(values=values.astype(np.float32), origin=(-1.0, -1.0, -1.0), cell=2.0 / CELLS)


def centers() -> np.ndarray:
    return volume(np.zeros((CELLS, CELLS, CELLS))).points.astype(np.float64)


def cameras() -> np.ndarray:
    """Above the middle, in all directions."""
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    low = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    high = np.stack([0.7 * np.cos(turn), 0.7 * np.sin(turn), 0 * turn + 0.7], axis=1)
    return (DISTANCE * np.concatenate([low, high, [[0, 0, 1]]])).astype(np.float32)


def at(positions: np.ndarray) -> list[Camera]:
    return [camera_from((float(x), float(y), float(z)), (64, 64)) for x, y, z in positions]


def ball(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points, axis=1) - RADIUS


def hull(points: np.ndarray) -> np.ndarray:
    """Of the ball as those at the height of its middle see it: below the lines of sight that touch it, a cone."""
    away, height = np.hypot(points[:, 0], points[:, 1]), -points[:, 2]
    tilt = np.arccos(RADIUS / DISTANCE)
    # The outermost tangent leaves where the ball's normal stands at this angle below the horizon.
    cone = np.cos(tilt) * away + np.sin(tilt) * height - RADIUS
    below = height > away * np.tan(tilt)
    return np.where(below, cone, ball(points))


def errors(shape: Volume) -> tuple[float, float]:
    """Mean distance from the ball of the surface's cells below where it is seen, and of all others, in cells."""
    points, values = centers(), shape.values.reshape(-1).astype(np.float64)
    off = np.abs(values - ball(points)) / shape.cell
    near, below = np.abs(ball(points)) < shape.cell, -points[:, 2] > 0.97 * np.linalg.norm(points, axis=1)
    return float(off[near & below].mean()), float(off[near & ~below].mean())


def test_a_cone_becomes_the_far_side_of_a_ball():
    shape = volume(hull(centers()).reshape(CELLS, CELLS, CELLS))
    closed = close_unseen(shape, at(cameras()))
    before, after = errors(shape), errors(closed)
    assert before[0] > 1.0
    assert after[0] < 0.3 * before[0]
    assert after[1] < before[1] + 0.02
    assert bool((closed.values[shape.values > 0] > 0).all())


def test_what_is_seen_from_all_sides_is_returned_as_it_is():
    around = np.concatenate([cameras(), -cameras()])
    for values in (ball(centers()), hull(centers())):
        shape = volume(values.reshape(CELLS, CELLS, CELLS))
        assert close_unseen(shape, at(around)) is shape


def test_without_a_surface_there_is_nothing_to_close():
    shape = volume(np.ones((CELLS, CELLS, CELLS)))
    assert close_unseen(shape, at(cameras())) is shape


def test_without_cameras_nothing_holds_a_patch():
    shape = volume(ball(centers()).reshape(CELLS, CELLS, CELLS))
    assert close_unseen(shape, at(np.zeros((0, 3), np.float32))) is shape


def test_one_view_says_too_little_about_the_far_side():
    shape = volume(ball(centers()).reshape(CELLS, CELLS, CELLS))
    assert close_unseen(shape, at(cameras()[:1])) is shape


def test_three_views_say_too_little_about_the_far_side():
    shape = volume(hull(centers()).reshape(CELLS, CELLS, CELLS))
    assert close_unseen(shape, at(cameras()[[0, 8, 16]])) is shape


def test_a_surface_that_leaves_the_cells_is_closed_at_their_edge():
    """A bar from wall to wall, whose ends no camera above it sees: they stay where they are."""
    x, y, z = centers().T
    shape = volume((np.hypot(y, z) - 0.4 - 0 * x).reshape(CELLS, CELLS, CELLS))
    closed = close_unseen(shape, at(3 * cameras()))
    middle = slice(CELLS // 4, -CELLS // 4)
    assert ((closed.values < 0) == (shape.values < 0))[middle].mean() > 0.999


def test_a_thin_plate_keeps_its_thickness():
    """Its lower side is not seen, and lies nearer to the upper one than a patch of its size would like to bend."""
    x, y, z = np.abs(centers()).T
    plate = np.maximum(np.maximum(x, y) - 0.7, z - 0.08)
    shape = volume(plate.reshape(CELLS, CELLS, CELLS))
    closed = close_unseen(shape, at(cameras()))
    solid = (shape.values < 0).sum()
    assert (closed.values < 0).sum() > 0.97 * solid


HEIGHT = 0.7
"""Of the lowest of the cameras that look down on what stands on a table, above it."""


def from_above() -> np.ndarray:
    return (3 * cameras() + np.array([0, 0, HEIGHT])).astype(np.float32)


def standing(above: np.ndarray, half_side: float) -> Volume:
    """The hull of a shape on a square foot at height 0: below it the lines of sight that touch the foot go on.

    ``above`` is negative inside of the shape, above the foot.
    """
    x, y, z = centers().T
    side, slope = np.maximum(np.abs(x), np.abs(y)), HEIGHT / (3 * DISTANCE - half_side)
    pyramid = (slope * (side - half_side) - z) / np.hypot(slope, 1)
    values = np.maximum(np.where(z < 0, pyramid, -1.0), np.maximum(side - half_side, above))
    return volume(values.reshape(CELLS, CELLS, CELLS))


def lowest(shape: Volume, radius: float) -> float:
    """Height of the lowest cell inside, this near to the axis."""
    x, y, z = centers().T
    return float(z[(np.hypot(x, y) < radius) & (shape.values.reshape(-1) < 0)].min())


def test_a_pyramid_below_a_sharp_rim_becomes_flat():
    """Nothing tells where the lower side of what stands on a table goes on from its edges."""
    shape = standing(centers()[:, 2] - 0.4, 0.6)
    closed = close_unseen(shape, at(from_above()))
    assert lowest(shape, 0.1) < -4 * shape.cell
    assert lowest(closed, 0.5) > -shape.cell
    # What is seen stays.
    above = centers()[:, 2].reshape(shape.shape) > 2 * shape.cell
    assert ((closed.values < 0) == (shape.values < 0))[above].all()


def test_a_membrane_does_not_cut_through_what_is_seen():
    """A bowl whose floor, seen from above, is lower than the rim that a flat lower side would hang from."""
    x, y, z = centers().T
    floor = -0.04
    hollow = 0.34 - np.sqrt(x**2 + y**2 + (z - floor - 0.34) ** 2)
    shape = standing(np.maximum(z - 0.2, hollow), 0.6)
    closed = close_unseen(shape, at(from_above()))
    assert lowest(shape, 0.05) < lowest(closed, 0.05) < floor - shape.cell


def test_a_patch_of_a_few_vertices_is_closed_as_well():
    """Nothing is left of it at the rings where a crease is looked for."""
    shape = standing(centers()[:, 2] - 0.4, 0.1)
    closed = close_unseen(shape, at(from_above()))
    assert np.isfinite(closed.values).all()
    assert (closed.values < 0).any()
