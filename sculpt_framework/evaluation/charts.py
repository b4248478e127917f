"""Charts as SVG text: lines over time and histograms. Pure functions; nothing is loaded from elsewhere."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from sculpt_framework.evaluation.triangle_quality import Histogram

WIDTH, HEIGHT = 460.0, 290.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 68.0, 14.0, 58.0, 48.0
_COLORS = ("#1f6fb4", "#c8553d", "#3a8f5c", "#8a5fb0")
"""Told apart in the common kinds of colour blindness, and dark enough on white."""
_INK, _MUTED, _GRID = "#222", "#666", "#e4e4e4"
_FONT = "system-ui, sans-serif"


@dataclass(frozen=True, kw_only=True)
class Series:
    """A named line; points are (x, y) in the order of x."""

    name: str
    points: Sequence[tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Axis:
    """What an axis shows; ``label`` names the quantity with its unit."""

    label: str
    log: bool = False


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """Numbers to pixels."""

    low: float
    high: float
    start: float
    end: float
    log: bool

    def __call__(self, value: float) -> float:
        transform: Callable[[float], float] = math.log10 if self.log else float
        low, high = transform(self.low), transform(self.high)
        return self.start + (self.end - self.start) * (transform(value) - low) / (high - low)

    def ticks(self) -> list[float]:
        return log_ticks(self.low, self.high) if self.log else linear_ticks(self.low, self.high)


def line_chart(title: str, series: Sequence[Series], x: Axis, y: Axis) -> str:
    """An SVG element with a line and its points per series, and a legend where there is more than one.

    Points that a logarithmic axis cannot show are left out. Raises ValueError if nothing is left to show.
    """
    shown = [Series(name=line.name, points=_showable(line.points, x, y)) for line in series]
    shown = [line for line in shown if line.points]
    if not shown:
        raise ValueError(f"chart {title!r} has no points")
    across = _scale([point[0] for line in shown for point in line.points], x, _LEFT, WIDTH - _RIGHT)
    up = _scale([point[1] for line in shown for point in line.points], y, HEIGHT - _BOTTOM, _TOP)
    parts = _frame(title, across, up, x, y)
    if len(shown) > 1:
        parts += _legend([line.name for line in shown])
    for line, color in zip(shown, _COLORS, strict=False):
        path = " ".join(f"{across(px):.1f},{up(py):.1f}" for px, py in line.points)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        parts += [
            f'<circle cx="{across(px):.1f}" cy="{up(py):.1f}" r="3" fill="{color}">'
            f"<title>{escape(line.name)} {number(py)} at {number(px)}</title></circle>"
            for px, py in line.points
        ]
    return _svg(title, parts)


def histogram_chart(title: str, histogram: Histogram, x: Axis, y: Axis) -> str:
    """An SVG element with a bar per bin, as percent of the histogram's total. ``y`` says of what."""
    shares = [100 * int(count) / max(histogram.total, 1) for count in histogram.counts]
    edges = histogram.edges.tolist()
    across = _Scale(low=edges[0], high=edges[-1], start=_LEFT, end=WIDTH - _RIGHT, log=False)
    up = _Scale(low=0.0, high=max(*shares, 1.0) * 1.05, start=HEIGHT - _BOTTOM, end=_TOP, log=False)
    parts = _frame(title, across, up, x, y)
    for share, low, high in zip(shares, edges[:-1], edges[1:], strict=True):
        left, right, top = across(low) + 0.5, across(high) - 0.5, up(share)
        parts.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{up(0.0) - top:.1f}"'
            f' fill="{_COLORS[0]}"><title>{number(low)} to {number(high)}: {share:.2f} %</title></rect>'
        )
    return _svg(title, parts)


def linear_ticks(low: float, high: float) -> list[float]:
    """At least four round numbers between ``low`` and ``high``, as coarse as that allows."""
    power = 10.0 ** math.ceil(math.log10(high - low))
    step = next(step for step in (power / n for n in (1, 2, 5, 10, 20, 50)) if (high - low) / step >= 4)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [index * step for index in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Round numbers between ``low`` and ``high``: powers of ten, with 2 and 5 or more where that would be too few."""
    exponents = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    for mantissas in ((1,), (1, 2, 5), (1, 2, 3, 4, 5, 6, 8)):
        ticks = [mantissa * 10.0**exponent for exponent in exponents for mantissa in mantissas]
        inside = [tick for tick in ticks if low * 0.999 <= tick <= high * 1.001]
        if len(inside) >= 3:
            return inside
    return linear_ticks(low, high)


def number(value: float) -> str:
    """A number for people: no more digits than it deserves, no exponent where it can be read without."""
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e6:
        text = f"{value:.{max(0, 3 - math.floor(math.log10(abs(value))))}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    return f"{value:.3g}"


def _showable(points: Sequence[tuple[float, float]], x: Axis, y: Axis) -> list[tuple[float, float]]:
    return [(px, py) for px, py in points if (px > 0 or not x.log) and (py > 0 or not y.log)]


def _scale(values: Sequence[float], axis: Axis, start: float, end: float) -> _Scale:
    """Room for all values with a little air; a single value gets air around it."""
    low, high = min(values), max(values)
    if axis.log:
        air = max((high / low) ** 0.04, 1.05)
        return _Scale(low=low / air, high=high * air, start=start, end=end, log=True)
    air = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return _Scale(low=low - air, high=high + air, start=start, end=end, log=False)


def _frame(title: str, across: _Scale, up: _Scale, x: Axis, y: Axis) -> list[str]:
    """Title, grid lines, tick labels and axis labels."""
    bottom, right = HEIGHT - _BOTTOM, WIDTH - _RIGHT
    parts = [_text(_LEFT, 20.0, title, size=15, weight="600")]
    for tick in across.ticks():
        parts.append(_line(across(tick), _TOP, across(tick), bottom, _GRID))
        parts.append(_text(across(tick), bottom + 17, number(tick), anchor="middle", color=_MUTED))
    for tick in up.ticks():
        parts.append(_line(_LEFT, up(tick), right, up(tick), _GRID))
        parts.append(_text(_LEFT - 7, up(tick) + 4, number(tick), anchor="end", color=_MUTED))
    parts.append(_line(_LEFT, bottom, right, bottom, _MUTED))
    parts.append(_text((_LEFT + right) / 2, HEIGHT - 8.0, x.label, anchor="middle"))
    middle = (_TOP + bottom) / 2
    label = _text(0.0, 0.0, y.label, anchor="middle")
    return [*parts, f'<g transform="translate(13 {middle:.0f}) rotate(-90)">{label}</g>']


def _legend(names: Sequence[str]) -> list[str]:
    """Swatches and names in one row between title and plot, spaced by the length of the names."""
    parts, left = [], _LEFT
    for name, color in zip(names, _COLORS, strict=False):
        parts.append(f'<rect x="{left:.0f}" y="33" width="14" height="4" fill="{color}"/>')
        parts.append(_text(left + 19, 39.0, name))
        left += 19 + 7.2 * len(name) + 14
    return parts


def _line(x1: float, y1: float, x2: float, y2: float, color: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{color}"/>'


def _text(
    x: float, y: float, text: str, *, anchor: str = "start", color: str = _INK, size: int = 12, weight: str = "400"
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{color}" font-size="{size}"'
        f' font-weight="{weight}">{escape(text)}</text>'
    )


def _svg(title: str, parts: Sequence[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img"'
        f' aria-label="{escape(title)}" font-family="{_FONT}">{"".join(parts)}</svg>'
    )
