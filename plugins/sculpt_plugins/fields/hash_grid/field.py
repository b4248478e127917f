"""An SDF on a multi-resolution hash grid: the distance to a sphere plus a decoded correction."""

from jaxtyping import Float
from torch import Tensor, nn

from sculpt_framework.encodings.hash_grid import HashEncoding
from sculpt_framework.fields import Field
from sculpt_framework.parameters import ParameterGroup
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig

_FIT_RATE = 0.012
"""Of the coarsest level, in object units per step: the initial surface may be half a unit away."""
_DECODER_FIT_RATE = 5e-3


class HashGridField(Field):
    """sdf(x) = |x| - radius + correction(x).

    Without a decoder the correction is a pyramid of grids: one number at every corner of every level, interpolated and
    added up. Each level is a parameter group of its own. Adam moves every table entry at about its group's rate,
    whatever the size of its gradient, so rates that fall with the cell size make coarse levels move the surface far
    and fine ones a little: a multigrid preconditioner, and the reason why the fine levels do not get noisy before the
    coarse ones have settled. With ``hidden_units`` there are several numbers per corner, side by side, and a
    decoder of one softplus layer that starts at about zero output.
    """

    def __init__(self, config: HashGridFieldConfig):
        super().__init__()
        self._config = config
        decoded = config.hidden_units > 0
        self._encoding = HashEncoding(
            levels=config.num_levels,
            # Without a decoder several numbers at a corner would have the same gradient and stay alike.
            features_per_level=config.features_per_level if decoded else 1,
            log2_table=config.log2_table,
            base_resolution=config.base_resolution,
            finest_resolution=config.finest_resolution,
            init_scale=1e-4 if decoded else 0.0,
            sum_levels=not decoded,
        )
        self._active_levels = config.num_levels
        self._decoder: nn.Module | None = None
        if decoded:
            first = nn.Linear(config.num_levels * config.features_per_level, config.hidden_units)
            last = nn.Linear(config.hidden_units, 1)
            nn.init.zeros_(last.bias)
            nn.init.normal_(last.weight, std=1e-3)
            self._decoder = nn.Sequential(first, nn.Softplus(beta=100.0), last)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        encoded = self._encoding(points, active_levels=self._active_levels)
        correction = (encoded if self._decoder is None else self._decoder(encoded))[:, 0]
        # The distance to the centre has no gradient there; a hair of rounding off gives it one.
        distance = (points.square().sum(dim=1) + 1e-12).sqrt()
        return distance - self._config.sphere_radius + correction

    def parameter_groups(self) -> list[ParameterGroup]:
        rate, falloff = self._config.rate, self._config.level_falloff
        return self._groups([rate * finer**-falloff for finer in self._finer], self._config.decoder_rate)

    def fit_groups(self) -> list[ParameterGroup]:
        return self._groups([_FIT_RATE / finer for finer in self._finer], _DECODER_FIT_RATE)

    @property
    def _finer(self) -> list[float]:
        """Cells of each level across one of the coarsest level."""
        resolutions = self._encoding.resolutions
        return [resolution / resolutions[0] for resolution in resolutions]

    def _groups(self, rates: list[float], decoder_rate: float) -> list[ParameterGroup]:
        """Every level with a rate of its own, and the decoder."""
        levels = zip(self._encoding.tables, rates, strict=True)
        groups = [ParameterGroup(parameters=[table], rate=rate) for table, rate in levels]
        if self._decoder is not None:
            groups.append(ParameterGroup(parameters=list(self._decoder.parameters()), rate=decoder_rate))
        return groups

    def set_detail(self, cell_size: float) -> None:
        if not self._config.coarse_to_fine:
            return
        # A level finer than the extraction grid would be seen at its corners only: noise in between.
        useful = [r for r in self._encoding.resolutions if 2.0 / r >= 0.99 * cell_size]
        self._active_levels = max(1, len(useful))
