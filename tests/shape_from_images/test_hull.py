"""The visual hull against slow and plain reckoning, and the volume it is tabulated in."""

import numpy as np
import pytest
import torch
from cameras_around import camera_from
from scipy import ndimage
from torch import Tensor

from sculpt_framework.shape_from_images import hull_kernels
from sculpt_framework.shape_from_images.hull import signed_mask_distance, visual_hull
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.types import View

CPU = torch.device("cpu")


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (5, 9), (40, 31)])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.9])
def test_distances_are_exact(shape: tuple[int, int], share: float):
    generator = np.random.default_rng(4)
    wanted = generator.random(shape) < share
    wanted.flat[generator.integers(wanted.size)] = True
    out = np.empty(shape)
    hull_kernels.squared_distances(wanted, out)
    np.testing.assert_array_equal(np.sqrt(out), ndimage.distance_transform_edt(~wanted))


def ball_view(position: tuple[float, float, float], size: tuple[int, int], radius: float) -> View:
    """The mask of a ball round the origin, with soft edges; its colours do not matter."""
    camera = camera_from(position, size)
    rows, columns = torch.meshgrid(torch.arange(size[1]), torch.arange(size[0]), indexing="ij")
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    ray = torch.stack([x, y, torch.ones_like(x)], dim=-1)
    center = camera.world_to_camera[:3, 3].double()
    ray = ray.double() / ray.double().norm(dim=-1, keepdim=True)
    missed = torch.linalg.cross(ray, center.expand_as(ray), dim=-1).norm(dim=-1)
    alpha = (0.5 + (radius - missed) * camera.fx / float(center.norm())).clamp(0, 1).float()
    return View(name=str(position), camera=camera, rgb=alpha[..., None].expand(-1, -1, 3).clone(), alpha=alpha)


def reckoned(view: View, point: Tensor) -> float:
    """What one view says, by the words of ``visual_hull``, without cutting the image."""
    camera = view.camera
    assert view.alpha is not None
    pixels = signed_mask_distance(view.alpha).double().numpy()
    x, y, depth = (camera.world_to_camera[:3, :3].double() @ point + camera.world_to_camera[:3, 3].double()).tolist()
    if depth <= 0:
        return -np.inf
    column, row = camera.fx * x / depth + camera.cx - 0.5, camera.fy * y / depth + camera.cy - 0.5
    u, v = min(max(column, 0), camera.width - 1), min(max(row, 0), camera.height - 1)
    beyond = np.hypot(column - u, row - v)
    edges = np.concatenate([view.alpha[0], view.alpha[-1], view.alpha[:, 0], view.alpha[:, -1]])
    if beyond > 0 and edges.max() >= 0.5:
        return -np.inf
    inside = ndimage.map_coordinates(pixels, [[v], [u]], order=1, mode="nearest")[0]
    return float(np.hypot(inside, beyond) if beyond > 0 else inside) * depth / max(camera.fx, camera.fy)


def test_the_hull_is_the_largest_that_any_view_says():
    # The third has the ball across its border, so it says nothing of what lies beyond.
    views = [
        ball_view((3.0, 0.5, 0.2), (60, 50), 0.6),
        ball_view((-0.3, 2.5, 1.0), (41, 63), 0.6),
        ball_view((0.2, -0.4, 2.0), (30, 30), 1.1),
    ]
    hull = visual_hull(views, 10)
    generator = torch.Generator().manual_seed(2)
    points = 3 * (torch.rand(4000, 3, generator=generator) - 0.5)
    ours = hull(points)
    theirs = torch.tensor([max(reckoned(view, point) for view in views) for point in points.double()]).float()
    near = theirs < 0.5
    # Where nothing of the image has been cut off, or in front of it, the two are the same.
    same = (ours - theirs).abs() < 1e-4
    assert bool(same[near & (theirs < 0.05)].all())
    assert bool((ours[theirs > 0] > 0).all())
    # Elsewhere distances to what was cut off are less exact, and never too large.
    radius = points.norm(dim=1)
    assert bool((ours <= (radius - 0.6).clamp(min=0) + 0.05)[radius > 0.6].all())
    assert bool((ours[~near] > 0).all())
    assert float(ours.max()) <= 0.5


def test_points_that_no_view_can_place():
    hull = visual_hull([ball_view((3.0, 0.0, 0.0), (40, 40), 0.5)], 10)
    behind, far, at_camera, no_number = hull(
        torch.tensor([[9.0, 0.0, 0.0], [-1e6, 1e6, 0.0], [3.0, 0.0, 0.0], [0.0, torch.nan, 0.0]])
    ).tolist()
    assert behind == far == at_camera == 0.5
    assert np.isnan(no_number)


def test_what_is_behind_all_cameras_is_outside():
    views = [ball_view((0.9, y, 0.1), (60, 60), 0.3) for y in (-0.3, 0.0, 0.3)]
    hull = visual_hull(views, 10)
    inside, behind, beside = hull(torch.tensor([[0.0, 0.0, 0.0], [2.0, 0.1, 0.1], [0.95, 3.0, 0.1]])).tolist()
    assert inside < 0
    assert behind > 0
    assert beside > 0


def test_a_view_of_one_pixel():
    camera = camera_from((3.0, 0.0, 0.0), (1, 1))
    view = View(name="one", camera=camera, rgb=torch.ones(1, 1, 3), alpha=torch.ones(1, 1))
    assert float(visual_hull([view], 10)(torch.zeros(1, 3))) < 0


def rod(points: Tensor) -> Tensor:
    """Thinner than a block, and a slit in a slab beside it."""
    thin = points[:, :2].sub(0.31).norm(dim=1) - 0.03
    slab = torch.maximum((points[:, 0] + 0.5).abs() - 0.3, points.abs().amax(dim=1) - 0.9)
    slit = (points[:, 1] - 0.11).abs() - 0.02
    return torch.minimum(thin, torch.maximum(slab, -slit))


def test_a_volume_is_sampled_where_the_surface_is():
    asked = []

    def counted(points: Tensor) -> Tensor:
        asked.append(len(points))
        return rod(points)

    volume = sample(counted, (1.0, 0.8, 0.9), 64, CPU)
    dense = rod(torch.from_numpy(volume.points)).reshape(volume.shape).numpy()
    np.testing.assert_array_equal(volume.values < 0, dense < 0)
    near = np.abs(dense) < volume.cell
    np.testing.assert_allclose(volume.values[near], dense[near], atol=1e-5)
    np.testing.assert_allclose(volume.values, dense, atol=4 * volume.cell)
    assert sum(asked) < 0.6 * dense.size


def test_what_no_image_shows_is_outside_where_all_masks_touch_their_borders():
    """A ball larger than the images: above it, where masks say nothing, there is nothing either."""
    views = [ball_view((3.0, y, 0.2), (40, 30), 2.5) for y in (-0.5, 0.0, 0.6)]
    hull = visual_hull(views, 3)
    high = torch.stack([torch.zeros(40), torch.zeros(40), torch.linspace(0.0, 3.0, 40)], dim=1)
    shown = np.array(
        [[bool(v.camera.shows(v.camera.project(high.double().numpy()))[i]) for v in views] for i in range(40)]
    )
    values = hull(high).numpy()
    assert (values[shown.all(axis=1)] < 0).all()
    assert (values[~shown.any(axis=1)] > 0).all()
    assert (~shown.any(axis=1)).sum() > 10
    # It is a distance: as far away as the nearest image's edge.
    assert np.abs(np.diff(values)).max() < 1.2 * 3.0 / 39
    closed = visual_hull([*views, ball_view((3.0, 0.0, 0.2), (40, 30), 0.3)], 4)
    assert closed(torch.tensor([[0.0, 0.0, 2.9]])) > 0
