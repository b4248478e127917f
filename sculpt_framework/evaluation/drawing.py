"""Drawings of lines, dots and words, independent of the file they end up in: SVG here, PNG in ``drawing_png.py``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Literal

FONT = "system-ui, sans-serif"


@dataclass(frozen=True, kw_only=True)
class Line:
    """From one point to another; ``dash`` is the length of dashes and of the gaps between them, 0 for none."""

    start: tuple[float, float]
    end: tuple[float, float]
    color: str
    width: float = 1.0
    dash: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Path:
    """A line through points, with round joints."""

    points: Sequence[tuple[float, float]]
    color: str
    width: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Dot:
    center: tuple[float, float]
    radius: float
    color: str
    note: str = ""
    """Shown by a browser under the pointer."""


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A filled rectangle."""

    corner: tuple[float, float]
    """Upper left."""
    width: float
    height: float
    color: str
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Words:
    """One line of text. ``place`` is on its baseline, at the side ``anchor`` names."""

    place: tuple[float, float]
    text: str
    color: str
    size: int = 12
    anchor: Literal["start", "middle", "end"] = "start"
    bold: bool = False
    upwards: bool = False
    """Turned by 90 degrees, read from below."""


Shape = Line | Path | Dot | Bar | Words


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Shapes on white, the later over the earlier. Lengths are pixels of a screen; y grows downwards."""

    title: str
    """For readers who cannot see it."""
    width: float
    height: float
    shapes: Sequence[Shape]


def moved(shape: Shape, right: float, down: float) -> Shape:
    """The same shape elsewhere."""

    def shift(point: tuple[float, float]) -> tuple[float, float]:
        return point[0] + right, point[1] + down

    match shape:
        case Line():
            return replace(shape, start=shift(shape.start), end=shift(shape.end))
        case Path():
            return replace(shape, points=[shift(point) for point in shape.points])
        case Dot():
            return replace(shape, center=shift(shape.center))
        case Bar():
            return replace(shape, corner=shift(shape.corner))
        case Words():
            return replace(shape, place=shift(shape.place))


def text_width(text: str, size: int = 12) -> float:
    """About how wide a text is, in pixels; rather too much than too little."""
    return 0.6 * size * len(text)


def to_svg(drawing: Drawing) -> str:
    """An SVG element, complete as a file of its own and fit to stand in a page."""
    body = "".join(_svg(shape) for shape in drawing.shapes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {drawing.width:.0f} {drawing.height:.0f}" role="img"'
        f' aria-label="{escape(drawing.title)}" font-family="{FONT}">{body}</svg>'
    )


def _svg(shape: Shape) -> str:
    match shape:
        case Line(start=(x1, y1), end=(x2, y2)):
            width = "" if shape.width == 1 else f' stroke-width="{shape.width:g}"'
            dash = f' stroke-dasharray="{shape.dash:g}"' if shape.dash else ""
            return (
                f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{shape.color}"{width}{dash}/>'
            )
        case Path():
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in shape.points)
            return (
                f'<polyline points="{points}" fill="none" stroke="{shape.color}" stroke-width="{shape.width:g}"'
                ' stroke-linejoin="round" stroke-linecap="round"/>'
            )
        case Dot(center=(x, y)):
            start = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{shape.radius:g}" fill="{shape.color}"'
            return f"{start}>{_note(shape.note)}</circle>" if shape.note else f"{start}/>"
        case Bar(corner=(x, y)):
            start = (
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{shape.width:.1f}" height="{shape.height:.1f}"'
                f' fill="{shape.color}"'
            )
            return f"{start}>{_note(shape.note)}</rect>" if shape.note else f"{start}/>"
        case Words(place=(x, y)):
            turned = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if shape.upwards else ""
            weight = 600 if shape.bold else 400
            return (
                f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{shape.anchor}" fill="{shape.color}"'
                f' font-size="{shape.size}" font-weight="{weight}"{turned}>{escape(shape.text)}</text>'
            )


def _note(note: str) -> str:
    return f"<title>{escape(note)}</title>"
