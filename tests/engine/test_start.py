"""What a run does before its first step: surfaces to start from, their rows of the curve, and the field's fit."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from small_runs import FIELDS, small_config, train
from torch import Tensor

from sculpt_framework.config import InitializerConfig
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.initializers import Initializer
from sculpt_framework.shape_from_images.field_fit import fit_field
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.testing import sphere_sdf
from sculpt_framework.types import Scene, View

CPU = torch.device("cpu")
CELLS = 48


def rippled_ball(points: Tensor) -> Tensor:
    """Waves of eight cells length and half a cell height on a ball."""
    wave = torch.cos(points * (2 * torch.pi / (8 * 2 / CELLS))).prod(dim=1)
    return points.norm(dim=1) - 0.5 - 0.5 * (2 / CELLS) * wave


# -- the fit ---------------------------------------------------------------------------------------------------------


def test_the_fit_keeps_what_the_volume_shows():
    torch.manual_seed(0)
    volume = sample(rippled_ball, (1.0, 1.0, 1.0), CELLS, CPU)
    field = replace(FIELDS["hash-grid"], finest_resolution=CELLS, log2_table=15).build(CELLS, CPU)
    field.set_detail(volume.cell)
    error = fit_field(field, volume, steps=200, generator=torch.Generator().manual_seed(0), device=CPU)
    assert error < 0.05 * volume.cell
    directions = torch.nn.functional.normalize(torch.randn(5000, 3), dim=1)
    on_ball = 0.5 * directions
    heights = -rippled_ball(on_ball)
    assert heights.std() > 0.1 * volume.cell
    assert float((field(on_ball).detach() + heights).abs().mean()) < 0.2 * float(heights.std())


@pytest.mark.parametrize("block", [2, 4])
def test_a_sampled_volume_has_the_signs_of_the_function(block: int):
    """A plate thinner than a block, of a function as much steeper than a distance as is allowed."""
    steep = {2: 1.5, 4: 1.2}[block]

    def plate(points: Tensor) -> Tensor:
        return steep * torch.maximum((points[:, 2] - 0.013).abs() - 0.02, points[:, :2].norm(dim=1) - 0.7)

    volume = sample(plate, (1.0, 0.8, 0.6), 64, CPU, block=block)
    assert (volume.values < 0).any()
    dense = plate(torch.from_numpy(volume.points)).numpy().reshape(volume.shape)
    assert ((volume.values < 0) == (dense < 0)).all()


# -- the curve -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class BallsConfig(InitializerConfig):
    """Balls one after the other; one without a radius has no surface."""

    radii: tuple[float, ...]

    def build(self) -> "Balls":
        return Balls(self.radii)


class Balls(Initializer):
    def __init__(self, radii: Sequence[float]):
        self._radii = radii

    def targets(self, views: Sequence[View], half_sides: Tensor, device: torch.device) -> Iterator[SdfFunction]:
        for radius in self._radii:
            yield sphere_sdf(radius) if radius else lambda points: torch.ones_like(points[:, 0])


def rows_from(scene: Scene, *radii: float) -> list[Mapping[str, Any]]:
    outcome = train(small_config(initializer=BallsConfig(radii=radii), steps=1), scene)
    return [each.data for each in outcome.of("evaluation")]


def test_the_curve_begins_with_what_the_start_is_made_of(scene: Scene):
    rows = rows_from(scene, 0.9, 0.0, 0.7)
    assert [row["reason"] for row in rows] == ["start", "start", "stage", "end of optimisation"]
    assert all(row["psnr"] is None and row["gaussians"] == 0 and row["faces"] > 0 for row in rows[:2])
    assert rows[0]["chamfer_ps"] > rows[1]["chamfer_ps"] > 0
    assert rows[2]["chamfer_ps"] == pytest.approx(rows[1]["chamfer_ps"], rel=0.2)


def test_of_a_start_nothing_is_known_without_a_reference(scene: Scene):
    rows = rows_from(replace(scene, reference_mesh=None), 0.7)
    assert [row["reason"] for row in rows] == ["stage", "end of optimisation"]


def test_an_initializer_that_makes_nothing_is_an_error(scene: Scene):
    with pytest.raises(ValueError, match="Balls makes nothing to start from"):
        rows_from(scene)
