"""Levels of the hash grid field: as wide as the cells it is sampled with."""

from dataclasses import replace

import pytest
import torch

from sculpt_framework.errors import ConfigError
from sculpt_framework.shape_from_images.field_fit import fit_field
from sculpt_framework.shape_from_images.volume import sample
from sculpt_framework.volume_rendering.config import RadianceConfig
from sculpt_plugins.appearances.color_field.config import ColorFieldConfig
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig

CPU = torch.device("cpu")


def levels(config: HashGridFieldConfig, cells: int) -> list[int]:
    """Entries of each level's table, as cells across: none is hashed here."""
    field = config.build(cells, CPU)
    return [round(table.shape[0] ** (1 / 3)) - 1 for group in field.parameter_groups() for table in group.parameters]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [(64, [4, 8, 16, 32, 64, 128]), (44, [6, 11, 22, 44, 88]), (3, [6]), (1, [2])],
)
def test_a_level_has_the_cells_of_the_grid_and_the_last_twice_as_many(cells: int, expected: list[int]):
    assert levels(HashGridFieldConfig(log2_table=24), cells) == expected


def test_what_is_given_holds_whatever_the_grid_has():
    given = HashGridFieldConfig(num_levels=3, base_resolution=4, finest_resolution=64, log2_table=24)
    assert levels(given, 44) == levels(given, 128) == [4, 16, 64]
    assert levels(HashGridFieldConfig(num_levels=2, log2_table=24), 16) == [4, 32]
    assert levels(HashGridFieldConfig(finest_resolution=40, log2_table=24), 128) == [5, 10, 20, 40]


@pytest.mark.parametrize(
    ("option", "config"),
    [
        ("field", HashGridFieldConfig(num_levels=1, base_resolution=16, finest_resolution=64)),
        ("appearance", ColorFieldConfig(num_levels=1, base_resolution=16, finest_resolution=64)),
        ("radiance", RadianceConfig(num_levels=1, base_resolution=16, finest_resolution=64)),
    ],
)
def test_one_level_has_one_resolution(option: str, config: HashGridFieldConfig | ColorFieldConfig | RadianceConfig):
    message = rf"^--{option}.finest-resolution is 64; expected {option}.base-resolution \(16\), as "
    with pytest.raises(ConfigError, match=message + rf"{option}.num-levels is 1\.$"):
        config.check(option)
    replace(config, finest_resolution=16).check(option)
    replace(config, num_levels=2).check(option)


@pytest.mark.parametrize("finest", [None, 16])
def test_a_single_level_has_the_base_resolution(finest: int | None):
    config = HashGridFieldConfig(num_levels=1, base_resolution=16, finest_resolution=finest, log2_table=24)
    config.check("field")
    assert levels(config, 44) == [16]


def fit_of_a_bar(config: HashGridFieldConfig, cells: int) -> tuple[float, float]:
    """Mean error near the surface of a bar as thick as one and a half cells, and how much of its axis is inside."""
    torch.manual_seed(0)
    axis = torch.nn.functional.normalize(torch.tensor([1.0, 0.7, 0.4]), dim=0)

    def bar(points: torch.Tensor) -> torch.Tensor:
        return (points - (points @ axis)[:, None] * axis).norm(dim=1) - 1.5 / cells

    volume = sample(bar, (1.0, 1.0, 1.0), cells, CPU)
    field = config.build(cells, CPU)
    field.set_detail(volume.cell)
    error = fit_field(field, volume, steps=120, generator=torch.Generator().manual_seed(0), device=CPU)
    with torch.no_grad():
        inside = field(torch.linspace(-0.8, 0.8, 2000)[:, None] * axis) < 0
    return error, float(inside.float().mean())


def test_a_thin_bar_needs_a_level_as_wide_as_the_cells():
    """Of levels up to 64 cells, 32 are the finest that are not finer than 44: they lose a part of the bar."""
    error, inside = fit_of_a_bar(HashGridFieldConfig(), 44)
    coarse_error, coarse_inside = fit_of_a_bar(HashGridFieldConfig(num_levels=5, finest_resolution=64), 44)
    assert inside == 1.0
    assert coarse_inside < 0.95
    assert error < 0.7 * coarse_error


def test_a_level_learns_as_fast_whatever_others_there_are():
    """Rates of training are those of the cells' widths; 44 cells are a level of both."""
    one, other = (HashGridFieldConfig(log2_table=24).build(cells, CPU).parameter_groups() for cells in (44, 88))
    assert [group.rate for group in one[1:]] == pytest.approx([group.rate for group in other[1:-1]])
    assert one[0].rate == pytest.approx(4e-3 * 4 / 6)
