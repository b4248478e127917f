"""Charts are well-formed, labelled, and put points where they belong."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from sculpt_framework.evaluation.charts import (
    Axis,
    Series,
    histogram_chart,
    line_chart,
    linear_ticks,
    log_ticks,
    number,
)
from sculpt_framework.evaluation.triangle_quality import Histogram

SVG = "{http://www.w3.org/2000/svg}"


def line(name: str = "error", *points: tuple[float, float]) -> Series:
    return Series(name=name, points=points or ((1.0, 0.01), (10.0, 0.001), (100.0, 0.0001)))


def test_a_power_law_is_a_straight_line_on_logarithmic_axes():
    root = ElementTree.fromstring(
        line_chart("Error", [line()], Axis(label="time, s", log=True), Axis(label="units", log=True))
    )
    points = root.find(f"{SVG}polyline").get("points")
    (x0, y0), (x1, y1), (x2, y2) = [tuple(map(float, pair.split(","))) for pair in points.split()]
    assert x1 == pytest.approx((x0 + x2) / 2, abs=0.11)
    assert y1 == pytest.approx((y0 + y2) / 2, abs=0.11)
    assert x0 < x2
    assert y0 < y2, "less error is further down, which is a larger y"
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert {"Error", "time, s", "units", "10", "0.001"} <= set(texts)


def test_a_legend_appears_with_a_second_line():
    axes = Axis(label="x"), Axis(label="y")
    assert ">first<" not in line_chart("t", [line("first")], *axes)
    two = line_chart("t", [line("first"), line("second")], *axes)
    assert ">first<" in two
    assert ">second<" in two


def test_what_a_logarithmic_axis_cannot_show_is_left_out():
    axes = Axis(label="x", log=True), Axis(label="y")
    chart = line_chart("t", [line("a", (0.0, 1.0), (1.0, 2.0), (2.0, 3.0))], *axes)
    assert chart.count("<circle") == 2
    with pytest.raises(ValueError, match="no points"):
        line_chart("t", [line("a", (0.0, 1.0))], *axes)


def test_a_single_point_and_a_constant_line_can_be_drawn():
    for points in (((3.0, 5.0),), ((1.0, 0.0), (2.0, 0.0))):
        chart = line_chart("t", [line("a", *points)], Axis(label="x", log=True), Axis(label="y"))
        assert "nan" not in chart
        assert "inf" not in chart


def test_text_is_escaped():
    chart = line_chart("<script>", [line("a&b"), line("c")], Axis(label="<x>"), Axis(label="y"))
    ElementTree.fromstring(chart)
    assert "<script>" not in chart


def test_histogram_bars_have_the_heights_of_their_shares():
    histogram = Histogram(edges=np.array([0.0, 10, 20, 30]), counts=np.array([10, 30, 0]), total=50)
    root = ElementTree.fromstring(histogram_chart("Angle", histogram, Axis(label="degrees"), Axis(label="%")))
    heights = [float(bar.get("height")) for bar in root.iter(f"{SVG}rect")]
    assert heights[1] == pytest.approx(3 * heights[0], abs=0.2)
    assert heights[2] == 0
    assert "10 to 20: 60.00 %" in ElementTree.tostring(root, encoding="unicode")


@pytest.mark.parametrize(("low", "high"), [(0, 1), (21.9, 31.8), (-3, 4), (0.0101, 0.0104), (800, 960), (0, 1e6)])
def test_linear_ticks_are_few_and_inside(low: float, high: float):
    ticks = linear_ticks(float(low), float(high))
    assert 4 <= len(ticks) <= 11
    assert all(low - 1e-9 <= tick <= high + 1e-9 for tick in ticks)
    labels = [number(tick) for tick in ticks]
    assert len(set(labels)) == len(labels)


@pytest.mark.parametrize(("low", "high"), [(1.0, 1000.0), (2.0, 120.0), (0.0018, 0.009), (3.0, 3.4), (1e-6, 1.0)])
def test_log_ticks_are_few_and_inside(low: float, high: float):
    ticks = log_ticks(low, high)
    assert 3 <= len(ticks) <= 11
    assert all(low * 0.99 <= tick <= high * 1.01 for tick in ticks)


def test_tick_labels_of_a_time_axis_do_not_overlap():
    chart = line_chart("t", [line("a", (0.5, 1.0), (3600.0, 2.0))], Axis(label="s", log=True), Axis(label="y"))
    labels = re.findall(r'<text x="([\d.]+)" y="259.0" text-anchor="middle"[^>]*>([^<]+)<', chart)
    assert len(labels) >= 3
    right = [float(x) + 3.5 * len(text) for x, text in labels]
    left = [float(x) - 3.5 * len(text) for x, text in labels]
    assert all(end < start for end, start in zip(right[:-1], left[1:], strict=True))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.002, "0.002"),
        (1234.5, "1234"),
        (31.756, "31.76"),
        (1e-6, "1e-06"),
        (-0.5, "-0.5"),
        (100.0, "100"),
    ],
)
def test_numbers_are_short(value: float, text: str):
    assert number(value) == text
