"""What measures and clocks are called in tables and at axes, with their units."""

from collections.abc import Mapping
from dataclasses import dataclass

from sculpt_framework.comparison.runs import Clock, Measure
from sculpt_framework.evaluation.charts import Axis, number


@dataclass(frozen=True, kw_only=True)
class MeasureWording:
    name: str
    unit: str
    """Empty for a plain number."""
    log: bool
    """Shown on a logarithmic axis."""

    @property
    def label(self) -> str:
        return f"{self.name}, {self.unit}" if self.unit else self.name

    @property
    def axis(self) -> Axis:
        return Axis(label=f"{self.label} (log)" if self.log else self.label, log=self.log)


MEASURES: Mapping[Measure, MeasureWording] = {
    "chamfer": MeasureWording(name="Chamfer distance", unit="scene units", log=True),
    "fscore": MeasureWording(name="F-score at 0.2 % of the diagonal", unit="", log=False),
    "normal_consistency": MeasureWording(name="normal consistency", unit="", log=False),
    "psnr": MeasureWording(name="PSNR on held-out views", unit="dB", log=False),
    "ssim": MeasureWording(name="SSIM on held-out views", unit="", log=False),
    "iou": MeasureWording(name="mask IoU on held-out views", unit="", log=False),
    "under10_pct": MeasureWording(name="triangles under 10 degrees", unit="%", log=False),
    "residual_px": MeasureWording(name="residual between photographs", unit="pixels", log=True),
}

CLOCKS: Mapping[Clock, str] = {
    "train": "training time, s",
    "wall": "time since the start of the process, s",
    "cpu": "CPU time of all threads, s",
}


def time_axis(clock: Clock) -> Axis:
    return Axis(label=f"{CLOCKS[clock]} (log)", log=True)


def shown(value: float | None) -> str:
    """A result for people: "failed" where it is infinitely bad, a dash where it is not known."""
    if value is None:
        return "-"
    return "failed" if value in (float("inf"), float("-inf")) else number(value)
