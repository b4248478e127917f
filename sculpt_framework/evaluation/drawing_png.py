"""Drawings as PNG, for places that show no SVG."""

import io
import math

from PIL import Image, ImageDraw, ImageFont

from sculpt_framework.evaluation.drawing import Bar, Dot, Drawing, Line, Path, Shape, Words

Point = tuple[float, float]
_FINER = 2
"""Painted that much larger and then reduced, so that lines have smooth edges."""
_PIXELS_AT_MOST = 80_000_000
"""Of what is painted, 240 MB: a page of hundreds of panels has smaller ones."""


def to_png(drawing: Drawing, scale: float = 2.0) -> bytes:
    """The drawing with ``scale`` pixels of the picture per pixel of the drawing, or fewer where that is too many."""
    scale = min(scale, math.sqrt(_PIXELS_AT_MOST / (drawing.width * drawing.height)) / _FINER)
    factor = scale * _FINER
    canvas = Image.new("RGB", (round(drawing.width * factor), round(drawing.height * factor)), "white")
    pen = ImageDraw.Draw(canvas)
    for shape in drawing.shapes:
        _paint(canvas, pen, shape, factor)
    small = canvas.resize((round(drawing.width * scale), round(drawing.height * scale)), Image.Resampling.BOX)
    out = io.BytesIO()
    # Few colours are in a diagram: a palette makes a third of the file.
    small.quantize(128, dither=Image.Dither.NONE).save(out, format="PNG", optimize=True)
    return out.getvalue()


def _paint(canvas: Image.Image, pen: ImageDraw.ImageDraw, shape: Shape, factor: float) -> None:
    match shape:
        case Line():
            whole = [(shape.start, shape.end)]
            for start, end in _dashes(shape.start, shape.end, shape.dash) if shape.dash else whole:
                pen.line([_times(start, factor), _times(end, factor)], shape.color, _thick(shape.width, factor))
        case Path():
            points = [_times(point, factor) for point in shape.points]
            pen.line(points, shape.color, _thick(shape.width, factor), joint="curve")
        case Dot(center=(x, y), radius=radius):
            box = [_times((x - radius, y - radius), factor), _times((x + radius, y + radius), factor)]
            pen.ellipse(box, shape.color)
        case Bar(corner=(x, y)):
            if shape.width > 0 and shape.height > 0:
                box = [_times((x, y), factor), _times((x + shape.width, y + shape.height), factor)]
                pen.rectangle(box, shape.color)
        case Words():
            _write(canvas, pen, shape, factor)


def _write(canvas: Image.Image, pen: ImageDraw.ImageDraw, words: Words, factor: float) -> None:
    font = ImageFont.load_default(max(1.0, words.size * factor))
    stroke = 0.35 * factor if words.bold else 0.0
    x, y = _times(words.place, factor)
    if not words.upwards:
        anchor = {"start": "ls", "middle": "ms", "end": "rs"}[words.anchor]
        pen.text((x, y), words.text, words.color, font, anchor=anchor, stroke_width=stroke)
        return
    left, top, right, bottom = font.getbbox(words.text, anchor="ls", stroke_width=stroke)
    aside = Image.new("L", (math.ceil(right - left), math.ceil(bottom - top)))
    ImageDraw.Draw(aside).text((-left, -top), words.text, 255, font, anchor="ls", stroke_width=stroke)
    turned = aside.transpose(Image.Transpose.ROTATE_90)
    # Turned, the text runs upwards from its start, and its baseline is at x.
    below = {"start": 0.0, "middle": 0.5, "end": 1.0}[words.anchor] * (right - left)
    place = (round(x + top), round(y + below - (right - left)))
    canvas.paste(Image.new("RGB", turned.size, words.color), place, turned)


def _dashes(start: Point, end: Point, dash: float) -> list[tuple[Point, Point]]:
    """The drawn pieces of a dashed line."""
    length = math.dist(start, end)

    def at(position: float) -> Point:
        share = min(1.0, position / length)
        return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])

    return [(at(2 * n * dash), at((2 * n + 1) * dash)) for n in range(math.ceil(length / (2 * dash)))]


def _times(point: Point, factor: float) -> Point:
    return point[0] * factor, point[1] * factor


def _thick(width: float, factor: float) -> int:
    return max(1, round(width * factor))
