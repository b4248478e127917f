"""Sheets to print, exact to the pixel: the board, its name, and a ruler that tells whether the print has its size."""

import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Int64, UInt8
from PIL import Image, ImageDraw, ImageFont

from sculpt_framework.errors import ConfigError, OutputError
from sculpt_framework.export.atomic import make_folder, write_atomically
from sculpt_framework.markers.boards import Board, dictionary_of

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4), "a3": (297.0, 420.0), "tabloid": (279.4, 431.8)}
"""Width and height in millimetres."""
PIXELS = 20
"""A millimetre: 508 to the inch, so that whole and half millimetres end at pixels."""
RULER = 100.0
_MARGIN, _FOOT = 8.0, 20.0
_TEXT, _SMALL = 3.2, 2.4
"""Heights of letters in millimetres."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sheet:
    pixels: UInt8[np.ndarray, "h w"]
    """0 black, 255 white; ``PIXELS`` to the millimetre."""
    origin: tuple[float, float]
    """Column and row of the middle of the board, in pixels."""


def draw_sheet(board: Board, paper: str) -> Sheet:
    """The sheet to print at 100 %. Raises ConfigError where the board is larger than the paper."""
    width, height = PAPERS[paper]
    placed = _on_paper(board, paper)
    image = Image.new("L", (round(width * PIXELS), round(height * PIXELS)), 255)
    origin = (width / 2 * PIXELS, (_MARGIN + (height - 2 * _MARGIN - _FOOT) / 2) * PIXELS)
    pixels = np.array(image)
    _draw_board(pixels, placed, board.ids, origin)
    image = Image.fromarray(pixels)
    draw = ImageDraw.Draw(image)
    _number(draw, placed, board.ids, origin)
    _foot(draw, board, width, height)
    return Sheet(pixels=np.where(np.array(image) < 128, 0, 255).astype(np.uint8), origin=origin)


def write_sheet(path: Path, sheet: Sheet) -> None:
    """As PDF of one page in the paper's size. Raises OutputError where it cannot be written."""
    if path.suffix.lower() != ".pdf":
        raise OutputError(f"--out {path}: expected a name that ends in .pdf.")
    page = Image.fromarray(sheet.pixels).convert("1", dither=Image.Dither.NONE)
    data = io.BytesIO()
    page.save(data, "PDF", resolution=PIXELS * 25.4, title=path.stem)
    make_folder(path.parent)
    write_atomically(path, data.getvalue())


def _on_paper(board: Board, paper: str) -> Board:
    """The board, single markers in as many columns as fit."""
    width, height = PAPERS[paper]
    room = (width - 2 * _MARGIN, height - 2 * _MARGIN - _FOOT)
    placed = board
    if board.kind == "single":
        columns = max(1, min(board.columns, int((room[0] + board.gap) // board.pitch)))
        placed = replace(board, columns=columns, rows=math.ceil(board.columns / columns))
    if placed.width > room[0] + 1e-9 or placed.height > room[1] + 1e-9:
        raise ConfigError(
            f"--board {board.name}: {placed.width:g} x {placed.height:g} mm do not fit on {paper}, which has room for "
            f"{room[0]:g} x {room[1]:g} mm; give a smaller side, fewer of them, or --paper with one of "
            f"{', '.join(PAPERS)}."
        )
    return placed


def _draw_board(
    pixels: UInt8[np.ndarray, "h w"], board: Board, ids: Int64[np.ndarray, " m"], origin: tuple[float, float]
) -> None:
    """A last row of single markers may be short."""
    if board.kind == "charuco":
        columns, rows = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
        for column, row in np.stack([columns, rows], axis=-1)[(columns + rows) % 2 == 0]:
            left = (column - board.columns / 2) * board.side
            _fill(pixels, origin, np.zeros((1, 1), np.uint8), left, (board.rows / 2 - row) * board.side, board.side)
    dictionary = dictionary_of(board.dictionary)
    modules = dictionary.markerSize + 2
    for number, (x, y) in zip(ids, board.marker_centers(), strict=False):
        bits = cv2.aruco.generateImageMarker(dictionary, int(number), modules)
        _fill(pixels, origin, bits, x - board.marker / 2, y + board.marker / 2, board.marker)


def _fill(
    pixels: UInt8[np.ndarray, "h w"],
    origin: tuple[float, float],
    bits: UInt8[np.ndarray, "m m"],
    left: float,
    top: float,
    side: float,
) -> None:
    """Paint square cells into a square with its upper left corner there, in millimetres."""
    edges = np.arange(len(bits) + 1) * side / len(bits)
    columns = np.rint(origin[0] + (left + edges) * PIXELS).astype(int)
    rows = np.rint(origin[1] - (top - edges) * PIXELS).astype(int)
    whole = np.repeat(np.repeat(bits, np.diff(rows), axis=0), np.diff(columns), axis=1)
    pixels[rows[0] : rows[-1], columns[0] : columns[-1]] = whole


def _number(draw: ImageDraw.ImageDraw, board: Board, ids: Int64[np.ndarray, " m"], origin: tuple[float, float]) -> None:
    """Numbers below the markers that have room for it."""
    if board.kind == "charuco":
        return
    for number, (x, y) in zip(ids, board.marker_centers(), strict=False):
        said = f"{number}" if board.kind == "ring" else f"{number}: {board.side:g} mm"
        place = (origin[0] + x * PIXELS, origin[1] - (y - board.marker / 2 - 0.75 * board.gap) * PIXELS)
        draw.text(place, said, fill=0, font=_font(min(_SMALL, 0.4 * board.gap)), anchor="mm")


def _foot(draw: ImageDraw.ImageDraw, board: Board, width: float, height: float) -> None:
    left, base = (width - RULER) / 2, height - _MARGIN - 2 * 1.5 * _TEXT
    for tick in range(round(RULER) + 1):
        length = 5.0 if tick % 10 == 0 else 3.5 if tick % 5 == 0 else 2.0
        x = (left + tick) * PIXELS
        draw.rectangle((x - 2, (base - length) * PIXELS, x + 1, base * PIXELS), fill=0)
    draw.rectangle((left * PIXELS, base * PIXELS - 3, (left + RULER) * PIXELS, base * PIXELS), fill=0)
    side = f"squares {board.side:g} mm, markers {board.marker:g} mm" if board.kind == "charuco" else ""
    side = side or f"markers {board.side:g} mm"
    lines = (
        f"--board {board.name}    {side}    {board.dictionary} {board.ids[0]} to {board.ids[-1]}",
        f"Print at 100 %. The ruler is {RULER:g} mm long; where it is not, give --ruler with the millimetres it has.",
    )
    for index, line in enumerate(lines):
        place = (width / 2 * PIXELS, (base + (index + 0.5) * 1.5 * _TEXT) * PIXELS)
        draw.text(place, line, fill=0, font=_font(_TEXT), anchor="mm")


def _font(height: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(height * PIXELS)
