"""Charts: lines over time and histograms, as drawings and as SVG text. Pure functions; nothing is loaded."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from sculpt_framework.evaluation.drawing import Bar, Dot, Drawing, Line, Path, Shape, Words, moved, text_width, to_svg
from sculpt_framework.evaluation.triangle_quality import Histogram

WIDTH, HEIGHT = 460.0, 290.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 76.0, 14.0, 58.0, 48.0
_TOP_ALONE = 36.0
"""Under the title, where no legend comes between."""
COLORS = (
    *("#1f6fb4", "#c8553d", "#3a8f5c", "#8a5fb0", "#b8860b", "#c2528b", "#2a9d9d", "#555555"),
    *("#0b2f66", "#7a1f1f", "#8fae1b", "#e08fa0"),
)
"""The first eight are told apart in the common kinds of colour blindness, as far as eight can be."""
_INK, _MUTED, _GRID = "#222222", "#666666", "#e4e4e4"
_LEGEND_ROW = 18.0


@dataclass(frozen=True, kw_only=True)
class Series:
    """A named line; points are (x, y) in the order of x. Series of one name share a colour and a place in the legend.

    "line" has a dot per point; "median" is as thick, without dots; "member" is thin and pale; "mark" is one large dot;
    "cross" is one diagonal cross; "level" is a dashed line across the whole chart at the first point's y.
    """

    name: str
    points: Sequence[tuple[float, float]]
    style: Literal["line", "median", "member", "mark", "cross", "level"] = "line"


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
    """``line_drawing`` as an SVG element."""
    return to_svg(line_drawing(title, series, x, y, colors=series_colors(series), legend=True))


def line_drawing(
    title: str, series: Sequence[Series], x: Axis, y: Axis, *, colors: Mapping[str, str], legend: bool
) -> Drawing:
    """Every series in its name's colour, and where asked a legend if there is more than one name.

    Points that a logarithmic axis cannot show are left out. Raises ValueError if nothing is left to show.
    """
    shown = [Series(name=line.name, points=_showable(line.points, x, y), style=line.style) for line in series]
    shown = [line for line in shown if line.points]
    if not shown:
        raise ValueError(f"chart {title!r} has no points")
    names = list(dict.fromkeys(line.name for line in shown))
    rows = _legend_rows(names, WIDTH - _LEFT - _RIGHT) if legend and len(names) > 1 else []
    top = _TOP + _LEGEND_ROW * max(0, len(rows) - 1) if rows or legend else _TOP_ALONE
    height = HEIGHT + top - _TOP
    # A level goes all the way across, wherever its point is.
    across = _scale(
        [point[0] for line in shown for point in line.points if line.style != "level"] or [1.0],
        x,
        _LEFT,
        WIDTH - _RIGHT,
    )
    up = _scale([point[1] for line in shown for point in line.points], y, height - _BOTTOM, top)
    shapes = _frame(title, across, up, x, y)
    shapes += _legend(rows, colors, _LEFT, 39.0)
    # What says most is drawn last.
    order = ("member", "level", "line", "median", "cross", "mark")
    for line in sorted(shown, key=lambda line: order.index(line.style)):
        shapes += _drawn(line, colors[line.name], across, up)
    return Drawing(title=title, width=WIDTH, height=height, shapes=shapes)


def series_colors(series: Sequence[Series]) -> Mapping[str, str]:
    """A colour per name, in the order of the names; from the thirteenth on colours come again."""
    names = dict.fromkeys(line.name for line in series)
    return {name: COLORS[index % len(COLORS)] for index, name in enumerate(names)}


def sheet(title: str, panels: Sequence[Drawing], colors: Mapping[str, str], *, columns: int) -> Drawing:
    """Drawings of one width beside and below each other, under one title and one legend for all."""
    columns = min(columns, len(panels))
    width = columns * WIDTH
    rows = _legend_rows(list(colors), width - _LEFT - _RIGHT)
    shapes: list[Shape] = [Words(place=(_LEFT, 24.0), text=title, color=_INK, size=17, bold=True)]
    shapes += _legend(rows, colors, _LEFT, 48.0)
    down = 48.0 + _LEGEND_ROW * max(0, len(rows) - 1) + 8.0
    for first in range(0, len(panels), columns):
        row = panels[first : first + columns]
        for index, panel in enumerate(row):
            shapes += [moved(shape, index * WIDTH, down) for shape in panel.shapes]
        down += max(panel.height for panel in row)
    return Drawing(title=title, width=width, height=down, shapes=shapes)


def histogram_chart(title: str, histogram: Histogram, x: Axis, y: Axis) -> str:
    """An SVG element with a bar per bin, as percent of the histogram's total. ``y`` says of what."""
    shares = [100 * int(count) / max(histogram.total, 1) for count in histogram.counts]
    edges = histogram.edges.tolist()
    across = _Scale(low=edges[0], high=edges[-1], start=_LEFT, end=WIDTH - _RIGHT, log=False)
    up = _Scale(low=0.0, high=max(*shares, 1.0) * 1.05, start=HEIGHT - _BOTTOM, end=_TOP, log=False)
    shapes = _frame(title, across, up, x, y)
    for share, low, high in zip(shares, edges[:-1], edges[1:], strict=True):
        left, right, top = across(low) + 0.5, across(high) - 0.5, up(share)
        note = f"{number(low)} to {number(high)}: {share:.2f} %"
        shapes.append(Bar(corner=(left, top), width=right - left, height=up(0.0) - top, color=COLORS[0], note=note))
    return to_svg(Drawing(title=title, width=WIDTH, height=HEIGHT, shapes=shapes))


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


def _drawn(line: Series, color: str, across: _Scale, up: _Scale) -> list[Shape]:
    places = [(across(px), up(py)) for px, py in line.points] if line.style != "level" else []
    notes = [f"{line.name} {number(py)} at {number(px)}" for px, py in line.points]
    match line.style:
        case "line":
            dots = [Dot(center=at, radius=3.0, color=color, note=note) for at, note in zip(places, notes, strict=True)]
            return [Path(points=places, color=color), *dots]
        case "median":
            return [Path(points=places, color=color, width=2.6)]
        case "member":
            return [Path(points=places, color=_pale(color), width=1.0)]
        case "mark":
            return [Dot(center=at, radius=4.5, color=color, note=note) for at, note in zip(places, notes, strict=True)]
        case "cross":
            arms = [((x - 4, y + s * 4), (x + 4, y - s * 4)) for x, y in places for s in (1, -1)]
            return [Line(start=start, end=end, color=color, width=2.0) for start, end in arms]
        case "level":
            height = up(line.points[0][1])
            return [Line(start=(across.start, height), end=(across.end, height), color=color, width=1.6, dash=5.0)]


def _pale(color: str) -> str:
    """Mixed with white, as lines behind a thicker one."""
    channels = [int(color[start : start + 2], 16) for start in (1, 3, 5)]
    return "#" + "".join(f"{round(255 - 0.5 * (255 - channel)):02x}" for channel in channels)


def _frame(title: str, across: _Scale, up: _Scale, x: Axis, y: Axis) -> list[Shape]:
    """Title, grid lines, tick labels and axis labels."""
    left, right, bottom, top = across.start, across.end, up.start, up.end
    shapes: list[Shape] = [Words(place=(left, 20.0), text=title, color=_INK, size=15, bold=True)]
    for tick in across.ticks():
        at = across(tick)
        shapes.append(Line(start=(at, top), end=(at, bottom), color=_GRID))
        shapes.append(Words(place=(at, bottom + 17), text=number(tick), color=_MUTED, anchor="middle"))
    for tick in up.ticks():
        at = up(tick)
        shapes.append(Line(start=(left, at), end=(right, at), color=_GRID))
        shapes.append(Words(place=(left - 7, at + 4), text=number(tick), color=_MUTED, anchor="end"))
    shapes.append(Line(start=(left, bottom), end=(right, bottom), color=_MUTED))
    middle, below = (left + right) / 2, bottom + _BOTTOM - 8
    shapes.append(Words(place=(middle, below), text=x.label, color=_INK, anchor="middle"))
    place = (13.0, (top + bottom) / 2)
    shapes.append(Words(place=place, text=y.label, color=_INK, anchor="middle", upwards=True))
    return shapes


def _legend_rows(names: Sequence[str], width: float) -> list[list[str]]:
    """Names in rows that fit, spaced by their lengths."""
    rows: list[list[str]] = [[]]
    used = 0.0
    for name in names:
        needed = _legend_width(name)
        if rows[-1] and used + needed > width:
            rows.append([])
            used = 0.0
        rows[-1].append(name)
        used += needed
    return rows


def _legend_width(name: str) -> float:
    return 19 + text_width(name) + 14


def _legend(rows: Sequence[Sequence[str]], colors: Mapping[str, str], left: float, baseline: float) -> list[Shape]:
    shapes: list[Shape] = []
    for index, row in enumerate(rows):
        at, down = left, baseline + index * _LEGEND_ROW
        for name in row:
            shapes.append(Bar(corner=(at, down - 6), width=14.0, height=4.0, color=colors[name]))
            shapes.append(Words(place=(at + 19, down), text=name, color=_INK))
            at += _legend_width(name)
    return shapes
