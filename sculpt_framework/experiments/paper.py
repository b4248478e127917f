"""The paper's own figures, as printed there, with their place: what our tables are shown beside.

They are copied as they are, mistakes included; docs/laboratory/experiments.md lists what is odd about them. The paper
does not say how its Chamfer distance (CD) is defined: squared or not, sum or mean of both directions, how many samples,
in which units. So its figures and ours stand in separate rows, and no row mixes them.
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

FAILED = None
"""A dash in the paper: reconstruction failure."""


@dataclass(frozen=True, kw_only=True)
class PaperTable:
    """A table of the paper: CD of methods (rows) on objects (columns)."""

    place: str
    unit: float
    """What the printed figures are multiples of, in the paper's unstated units of length."""
    objects: tuple[str, ...]
    rows: Mapping[str, tuple[float | None, ...]]
    means: Mapping[str, float]
    """The column "Mean" as printed."""
    ours: str
    """The row of the paper's own method."""

    def wins(self) -> dict[str, int]:
        """On how many objects each method has the smallest figure as printed; ties count for all."""
        columns = list(zip(*self.rows.values(), strict=True))
        best = [min(value for value in column if value is not None) for column in columns]
        return {
            name: sum(value == least for value, least in zip(row, best, strict=True)) for name, row in self.rows.items()
        }

    def failures(self, name: str) -> int:
        return sum(value is None for value in self.rows[name])


def median_with_failures(values: Sequence[float | None]) -> float:
    """Median of a row, a failure counting as infinitely bad."""
    return statistics.median(math.inf if value is None else value for value in values)


ABLATION_PLACE = 'Table 3, "Ablation Studies on the NeRF Synthetic Dataset"'
ABLATION: Mapping[str, float] = {
    "none": 11.40,  # "Baseline"
    "only-opacity": 2.87,  # "Only Opacity"
    "no-scale": 1.58,  # "w/o Scale"
    "no-distribution": 1.36,  # "w/o Distribution"
    "all": 1.16,  # "Full Model"
}
"""CD by the name of our level of the factor "constraints". Its unit is not printed; the full model has the mean of
Table 2, which is in 1e-2."""
ABLATION_REMARKS: Mapping[str, str] = {
    "discrete": 'Figure "neural implicit SDF" (a): discrete SDFs "tend to produce noise"; no figures',
    "no-isolation": "the same figure (b): surface quality degrades; no figures",
    "cold-start": "not in the paper, which always starts cold, for 1000 inner steps (4.1)",
}
"""What the paper says of the factors that its Table 3 does not have."""

NERF_SYNTHETIC = PaperTable(
    place='Table 2, "Quantitative results on the NeRF Synthetic dataset"',
    unit=1e-2,
    objects=("Chair", "Hotdog", "Lego", "Drums", "Mic"),
    rows={
        "NeRF 128": (3.62, 4.19, 3.07, 6.91, 8.31),
        "NeRF 512": (2.16, 2.04, 1.85, 1.89, 1.24),
        "VolSDF": (1.18, 3.22, 2.26, 4.03, 1.14),
        "NeuS 128": (1.34, 2.12, 2.56, 4.10, 1.01),
        "NeuS 512": (1.62, 2.02, 1.58, 3.79, 0.78),
        "RelightableGaussian": (3.65, 3.11, 1.63, 2.34, 1.13),
        "SuGaR low": (2.37, 4.01, 1.46, 6.21, 4.80),
        "SuGaR high": (1.74, 3.18, 1.62, 4.86, 4.47),
        "2DGS 128": (8.07, 4.37, 4.18, 5.75, 4.92),
        "2DGS 1024": (1.71, 2.87, 4.18, 4.01, 2.51),
        "PGSR": (1.76, 3.14, 1.99, 1.54, 1.17),
        "GOF": (2.51, 3.63, 2.22, 1.42, 0.99),
        "GSDF 128": (1.78, 2.45, 2.74, 4.11, 7.35),
        "GSDF 512": (1.62, 3.08, 1.58, 3.79, 7.13),
        "3DGSR": (1.01, 1.48, 1.45, 0.95, 1.15),
        "Ours 128": (0.71, 1.76, 1.29, 0.93, 1.12),
    },
    means={
        "NeRF 128": 5.22,
        "NeRF 512": 1.84,
        "VolSDF": 2.37,
        "NeuS 128": 2.23,
        "NeuS 512": 1.96,
        "RelightableGaussian": 2.37,
        "SuGaR low": 3.77,
        "SuGaR high": 3.17,
        "2DGS 128": 5.46,
        "2DGS 1024": 3.06,
        "PGSR": 1.92,
        "GOF": 2.15,
        "GSDF 128": 3.69,
        "GSDF 512": 3.44,
        "3DGSR": 1.21,
        "Ours 128": 1.16,
    },
    ours="Ours 128",
)

OMNIOBJECT3D = PaperTable(
    place='Table 1, "The 12 objects are shown from left to right in groups of four"',
    unit=1e-3,
    objects=(
        *("Banana", "Dumpling", "Walnut", "Peanut"),
        *("Teapot", "Toy_plane", "Handbag", "Pumpkin"),
        *("Toy_train", "Durian", "Kennel", "Pan"),
    ),
    rows={
        "NeRF": (38.22, 68.54, 252.81, 69.43, 65.96, 13.76, 70.24, 239.94, 46.75, 25.51, 13.36, 13.20),
        "NeuS": (5.95, 27.70, 51.02, 12.68, 29.13, 5.51, FAILED, 44.05, 8.87, 19.24, 7.12, 11.07),
        "SuGaR": (74.18, 67.16, 17.99, 21.33, 75.95, 95.78, 19.33, 58.50, 80.26, 111.20, 36.90, 31.28),
        "2DGS": (11.70, 6.88, 52.37, 29.26, 36.75, 15.63, 36.63, 71.45, 29.96, 25.05, 27.55, 9.18),
        "PGSR": (7.24, 15.04, 8.62, 10.22, 17.02, 15.67, 11.67, 30.87, 11.77, 65.99, 13.49, 9.15),
        "GOF": (9.10, 4.95, 8.31, 6.24, 6.39, 7.48, 7.41, 72.17, 12.35, 22.37, 15.52, 6.60),
        "GSDF": (1.60, 6.64, 4.72, 6.76, 8.14, FAILED, FAILED, 9.71, 10.56, 24.77, 59.18, FAILED),
        "Ours": (4.78, 11.66, 6.17, 7.35, 6.10, 7.83, 14.38, 8.73, 8.54, 21.71, 5.90, 5.95),
    },
    means={
        "NeRF": 76.48,
        "NeuS": 20.21,
        "SuGaR": 57.49,
        "2DGS": 29.37,
        "PGSR": 18.06,
        "GOF": 14.91,
        "GSDF": 14.68,
        "Ours": 9.09,
    },
    ours="Ours",
)
