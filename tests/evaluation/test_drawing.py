"""Drawings come out the same as SVG and as PNG, and nothing lies outside or over each other."""

import io
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from sculpt_framework.evaluation.charts import Axis, Series, line_drawing, series_colors, sheet
from sculpt_framework.evaluation.drawing import Bar, Dot, Drawing, Line, Path, Words, moved, text_width, to_svg
from sculpt_framework.evaluation.drawing_png import to_png

SVG = "{http://www.w3.org/2000/svg}"


def pixels(drawing: Drawing, scale: float = 2.0) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(to_png(drawing, scale))).convert("RGB"))


def drawing(*shapes: Line | Path | Dot | Bar | Words) -> Drawing:
    return Drawing(title="t", width=100.0, height=60.0, shapes=shapes)


def painted(drawing: Drawing) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of what is not white, in pixels of the drawing."""
    rows, columns = np.nonzero(pixels(drawing, 1.0).min(axis=2) < 160)
    return columns.min(), rows.min(), columns.max(), rows.max()


def test_shapes_are_painted_where_they_are():
    assert painted(drawing(Bar(corner=(20.0, 10.0), width=30.0, height=5.0, color="#000000"))) == (20, 10, 50, 15)
    dot = painted(drawing(Dot(center=(50.0, 30.0), radius=5.0, color="#000000")))
    assert dot == pytest.approx((45, 25, 55, 35), abs=1)
    left, top, right, bottom = painted(drawing(Path(points=[(10.0, 10.0), (90.0, 50.0)], color="#000000")))
    assert (left, top, right, bottom) == pytest.approx((10, 10, 90, 50), abs=2)


def test_colours_are_kept_and_scale_enlarges():
    picture = pixels(drawing(Bar(corner=(0.0, 0.0), width=100.0, height=60.0, color="#1f6fb4")), 3.0)
    assert picture.shape == (180, 300, 3)
    np.testing.assert_allclose(picture.reshape(-1, 3).mean(axis=0), [0x1F, 0x6F, 0xB4], atol=2)


def test_a_sheet_of_a_thousand_panels_fits_into_memory(monkeypatch: pytest.MonkeyPatch):
    new = Image.new

    def bounded(mode: str, size: tuple[int, int], *more: object) -> Image.Image:
        assert size[0] * size[1] <= 1.05e6
        return new(mode, size, *more)

    monkeypatch.setattr("sculpt_framework.evaluation.drawing_png._PIXELS_AT_MOST", 1_000_000)
    monkeypatch.setattr("sculpt_framework.evaluation.drawing_png.Image.new", bounded)
    shapes = [Words(place=(500.0, 150_000.0), text="H", color="#000000", upwards=up) for up in (False, True)]
    tall = Drawing(title="t", width=1040.0, height=300_000.0, shapes=shapes)
    picture = Image.open(io.BytesIO(to_png(tall)))
    assert picture.height / picture.width == pytest.approx(300_000 / 1040, rel=0.05)


def test_dashes_cover_about_half_the_way():
    def share(line: Line) -> float:
        return (pixels(drawing(line))[60, 20:180].min(axis=1) < 128).mean()

    ends = {"start": (10.0, 30.0), "end": (90.0, 30.0), "color": "#000000", "width": 2.0}
    assert share(Line(**ends)) == 1
    assert share(Line(**ends, dash=5.0)) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("anchor", "left", "right"), [("start", 50, 90), ("middle", 30, 70), ("end", 10, 50)])
def test_words_stand_at_their_anchor(anchor: str, left: int, right: int):
    flat = painted(drawing(Words(place=(50.0, 30.0), text="HHHH", color="#000000", anchor=anchor)))
    assert flat[3] == pytest.approx(29, abs=1), "on the baseline"
    assert left <= flat[0] + 1
    assert flat[2] - 1 <= right
    # Turned, it runs upwards from where it started to the right, and its baseline is on the right.
    square = Drawing(title="t", width=100.0, height=100.0, shapes=())
    words = Words(place=(50.0, 50.0), text="HHHH", color="#000000", anchor=anchor, upwards=True)
    turned = painted(Drawing(title="t", width=100.0, height=100.0, shapes=[words]))
    assert turned[2] == pytest.approx(49, abs=1)
    assert (turned[3] - turned[1]) == pytest.approx(flat[2] - flat[0], abs=1)
    assert turned[1] == pytest.approx(square.height - 1 - flat[2], abs=2)


def test_svg_is_one_element_with_escaped_text():
    shapes = [
        Words(place=(1.0, 2.0), text="<a&b>", color="#000000", upwards=True),
        Dot(center=(1.0, 1.0), radius=1.0, color="#fff", note="<n>"),
    ]
    root = ElementTree.fromstring(to_svg(drawing(*shapes)))
    assert root.find(f"{SVG}text").text == "<a&b>"
    assert root.find(f"{SVG}text").get("transform") == "rotate(-90 1.0 2.0)"
    assert root.find(f"{SVG}circle/{SVG}title").text == "<n>"


def test_moving_moves_all_of_a_shape():
    for shape in (
        Line(start=(1.0, 2.0), end=(3.0, 4.0), color="#000000"),
        Path(points=[(1.0, 2.0), (3.0, 4.0)], color="#000000"),
        Dot(center=(5.0, 6.0), radius=2.0, color="#000000"),
        Bar(corner=(7.0, 8.0), width=2.0, height=2.0, color="#000000"),
        Words(place=(9.0, 20.0), text="H", color="#000000"),
    ):
        before, after = painted(drawing(shape)), painted(drawing(moved(shape, 20.0, 10.0)))
        assert np.subtract(after, before).tolist() == [20, 10, 20, 10]


def box(words: Words) -> tuple[float, float, float, float]:
    """About where a text is: left, top, right, bottom."""
    width, (x, y) = text_width(words.text, words.size), words.place
    before = {"start": 0.0, "middle": 0.5, "end": 1.0}[words.anchor] * width
    if words.upwards:
        return x - 0.8 * words.size, y - width + before, x + 0.2 * words.size, y + before
    return x - before, y - 0.8 * words.size, x - before + width, y + 0.2 * words.size


@pytest.mark.parametrize("count", [1, 4, 12])
def test_no_text_of_a_sheet_lies_over_another_or_outside(count: int):
    """Long names, many of them, in three panels with logarithmic axes."""
    series = [
        Series(name=f"method-{n} with a long name", points=[(1.0, 0.02 * (n + 1)), (90.0, 0.003)], style="median")
        for n in range(count)
    ]
    x, y = Axis(label="training time, s (log)", log=True), Axis(label="Chamfer distance, scene units (log)", log=True)
    colors = series_colors(series)
    panels = [line_drawing(scene, series, x, y, colors=colors, legend=False) for scene in ("one", "two", "three")]
    whole = sheet("Chamfer distance against time", panels, colors, columns=2)
    texts = [shape for shape in whole.shapes if isinstance(shape, Words)]
    assert len({text.text for text in texts}) > count + 10
    boxes = [(text.text, box(text)) for text in texts]
    for name, (left, top, right, bottom) in boxes:
        assert left >= 0, name
        assert right <= whole.width, name
        assert top >= 0, name
        assert bottom <= whole.height, name
    for (one, a), (other, b) in combinations(boxes, 2):
        apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
        assert apart, f"{one!r} lies over {other!r}"


def test_a_single_panel_makes_room_for_its_legend():
    series = [Series(name=f"a rather long name of a method {n}", points=[(1.0, n + 1.0), (2.0, 3.0)]) for n in range(6)]
    x, y = Axis(label="x"), Axis(label="y")
    whole = line_drawing("title", series, x, y, colors=series_colors(series), legend=True)
    plain = line_drawing("title", series[:1], x, y, colors=series_colors(series), legend=True)
    assert whole.height > plain.height + 4 * 18
    assert sum(isinstance(shape, Words) and shape.text.startswith("a rather") for shape in whole.shapes) == 6


def test_more_names_than_colours_are_all_drawn():
    series = [Series(name=str(n), points=[(1.0, 1.0), (2.0, n + 1.0)]) for n in range(11)]
    whole = line_drawing("t", series, Axis(label="x"), Axis(label="y"), colors=series_colors(series), legend=True)
    assert sum(isinstance(shape, Path) for shape in whole.shapes) == 11
