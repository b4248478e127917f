"""An SDF on a multi-resolution hash grid: the distance to a sphere plus a correction."""

from jaxtyping import Float
from torch import Tensor

from sculpt_framework.encodings.hash_grid import HashEncoding
from sculpt_framework.fields import Field
from sculpt_framework.parameters import ParameterGroup
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig

_FIT_RATE = 0.012
"""Of the coarsest level, in object units per step: the initial surface may be half a unit away."""


class HashGridField(Field):
    """sdf(x) = |x| - radius + correction(x).

    The correction is a pyramid of grids: one number at every corner of every level, interpolated and added up. Each
    level is a parameter group of its own. Adam moves every table entry at about its group's rate, whatever the size of
    its gradient, so rates that fall with the cell size make coarse levels move the surface far and fine ones a little:
    a multigrid preconditioner, and the reason why the fine levels do not get noisy before the coarse ones have settled.
    """

    def __init__(self, config: HashGridFieldConfig, cells: int):
        super().__init__()
        self._config = config
        levels = config.num_levels
        finest = config.finest_resolution or (config.base_resolution if levels == 1 else 2 * cells)
        coarsest = min(config.base_resolution, finest)
        if levels is None:
            levels = (finest // coarsest).bit_length()
            coarsest = finest / 2 ** (levels - 1)
        self._encoding = HashEncoding(
            levels=levels,
            # Several numbers at a corner would have the same gradient and stay alike.
            features_per_level=1,
            log2_table=config.log2_table,
            base_resolution=coarsest,
            finest_resolution=finest,
            init_scale=0.0,
            sum_levels=True,
        )
        self._active_levels = levels

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        correction = self._encoding(points, active_levels=self._active_levels)[:, 0]
        # The distance to the centre has no gradient there; a hair of rounding off gives it one.
        distance = (points.square().sum(dim=1) + 1e-12).sqrt()
        return distance - self._config.sphere_radius + correction

    def parameter_groups(self) -> list[ParameterGroup]:
        return self._groups(self._config.rate, self._config.base_resolution)

    def fit_groups(self) -> list[ParameterGroup]:
        return self._groups(_FIT_RATE, self._encoding.resolutions[0])

    def _groups(self, rate: float, cells: int) -> list[ParameterGroup]:
        """Every level with a rate in proportion to the width of its cells: the given one for so many across."""
        return [
            ParameterGroup(parameters=[table], rate=rate * cells / resolution)
            for table, resolution in zip(self._encoding.tables, self._encoding.resolutions, strict=True)
        ]

    def set_detail(self, cell_size: float) -> None:
        # A level finer than the extraction grid would be seen at its corners only: noise in between.
        useful = [r for r in self._encoding.resolutions if 2.0 / r >= 0.99 * cell_size]
        self._active_levels = max(1, len(useful))
