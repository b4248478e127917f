"""What can be printed: a ChArUco board, a ring of markers around a free place, single markers.

The frame of a board, in metres: origin at its middle, x to the right and y up as one reads the sheet, z out of the
paper.
"""

import re
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float64, Int64

from sculpt_framework.errors import ConfigError

Kind = Literal["charuco", "ring", "single"]
MILLIMETRE = 1e-3
GRAMMAR = "charuco-COLUMNSxROWS-SIDE[-MARKER], ring-COLUMNSxROWS-SIDE or single-COUNT-SIDE, sides in mm"
_DICTIONARIES: dict[Kind, str] = {"charuco": "5x5_100", "ring": "apriltag_36h11", "single": "apriltag_36h11"}
_FIRST: dict[Kind, int] = {"charuco": 0, "ring": 0, "single": 100}
"""Single markers have other numbers than a ring's, so that both can be in one photograph."""
_FEWEST: dict[Kind, int] = {"charuco": 3, "ring": 3, "single": 1}
_MARKER = 0.75
"""A ChArUco marker's side in sides of its square."""
_GAP = 1 / 3
"""Between a ring's markers, in sides of a marker: AprilTags need an eighth of white around them."""
_SIDES = (2.0, 1000.0)
_SPEC = re.compile(
    r"(?P<kind>charuco|ring|single)-(?P<columns>\d{1,3})(?:x(?P<rows>\d{1,3}))?-(?P<side>\d+(?:\.\d+)?)"
    r"(?:-(?P<marker>\d+(?:\.\d+)?))?(?:-(?P<dictionary>[a-z0-9]+_[a-z0-9]+))?(?:@(?P<first>\d{1,4}))?"
)


@dataclass(frozen=True, kw_only=True)
class Board:
    """Sides are in millimetres, as on paper."""

    name: str
    """As the user gives it, and as it is printed on the sheet."""
    kind: Kind
    columns: int
    """Of squares, or of markers along the ring's sides; of single markers, their number."""
    rows: int
    side: float
    """Of a ChArUco square, or of a marker."""
    marker: float
    """Side of a marker's black square."""
    dictionary: str
    first: int
    """Number of the first marker; the others follow."""

    @property
    def width(self) -> float:
        """Of the printed part, in millimetres."""
        return self.columns * self.pitch - self.gap

    @property
    def height(self) -> float:
        return self.rows * self.pitch - self.gap

    @property
    def gap(self) -> float:
        """Between neighbours, in millimetres."""
        return 0.0 if self.kind == "charuco" else self.side * _GAP

    @property
    def pitch(self) -> float:
        return self.side + self.gap

    @property
    def free(self) -> tuple[float, float] | None:
        """Width and height of a ring's free place, in millimetres; None of other boards."""
        if self.kind != "ring":
            return None
        return self.width - 2 * self.pitch, self.height - 2 * self.pitch

    @property
    def ids(self) -> Int64[np.ndarray, " m"]:
        """The markers' numbers."""
        return self.first + np.arange(len(self.marker_centers()))

    def printed_at(self, ruler: float) -> "Board":
        """The board as it is on a sheet whose ruler of 100 mm measures ``ruler`` mm."""
        return replace(self, side=self.side * ruler / 100, marker=self.marker * ruler / 100)

    def marker_centers(self) -> Float64[np.ndarray, "m 2"]:
        """In millimetres, in the board's frame, in the order of the numbers: row by row from the upper left."""
        columns, rows = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        if self.kind == "charuco":
            used = (columns + rows) % 2 == 1
        elif self.kind == "ring":
            used = (columns % (self.columns - 1) == 0) | (rows % (self.rows - 1) == 0)
        else:
            used = np.ones_like(columns, bool)
        x = (columns[used] - (self.columns - 1) / 2) * self.pitch
        y = ((self.rows - 1) / 2 - rows[used]) * self.pitch
        return np.stack([x, y], axis=1)

    def points(self) -> Float64[np.ndarray, "n 3"]:
        """Where the points that are detected lie, in metres: a ChArUco board's inner corners, row by row, or the
        corners of each marker, clockwise from the upper left. Of single markers only those of one marker fit together.
        """
        if self.kind == "charuco":
            columns, rows = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
            flat = np.stack([columns - self.columns / 2, self.rows / 2 - rows], axis=-1).reshape(-1, 2) * self.side
        else:
            corners = 0.5 * self.marker * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
            flat = (self.marker_centers()[:, None] + corners).reshape(-1, 2)
        return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1) * MILLIMETRE


def board_of(spec: str) -> Board:
    """The board a user names. Raises ConfigError for text that names none, and for one that cannot be printed."""
    match = _SPEC.fullmatch(spec.strip().lower())
    if match is None or (match["rows"] is None) != (match["kind"] == "single"):
        raise ConfigError(f"--board {spec}: expected {GRAMMAR}; the name is printed on each sheet.")
    kind: Kind = match["kind"]  # pyright: ignore[reportAssignmentType]
    columns, rows, side = int(match["columns"]), int(match["rows"] or 1), float(match["side"])
    if match["marker"] is not None and kind != "charuco":
        raise ConfigError(f"--board {spec}: only a ChArUco board has markers of a size of their own; leave it out.")
    marker = side if kind != "charuco" else float(match["marker"] or _MARKER * side)
    if min(columns, rows if kind != "single" else columns) < _FEWEST[kind]:
        raise ConfigError(f"--board {spec}: {columns}x{rows} is too few; expected {_FEWEST[kind]} or more.")
    if not (_SIDES[0] <= marker <= side <= _SIDES[1]) or (kind == "charuco" and marker == side):
        raise ConfigError(
            f"--board {spec}: expected sides of {_SIDES[0]:g} to {_SIDES[1]:g} mm, a marker's below its square's."
        )
    board = Board(
        name=spec.strip().lower(),
        kind=kind,
        columns=columns,
        rows=rows,
        side=side,
        marker=marker,
        dictionary=match["dictionary"] or _DICTIONARIES[kind],
        first=_FIRST[kind] if match["first"] is None else int(match["first"]),
    )
    there = len(dictionary_of(board.dictionary).bytesList)
    last = board.first + len(board.marker_centers()) - 1
    if last >= there:
        raise ConfigError(
            f"--board {spec}: needs markers {board.first} to {last}; {board.dictionary} has 0 to {there - 1}. Give "
            "fewer, or a lower first number."
        )
    return board


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's markers of that name, such as 5x5_100 or apriltag_36h11. Raises ConfigError for an unknown name."""
    known = {key.removeprefix("DICT_").lower(): value for key, value in vars(cv2.aruco).items() if key[:5] == "DICT_"}
    if name not in known:
        raise ConfigError(f"--board: no dictionary {name}; expected one of {', '.join(sorted(known))}.")
    return cv2.aruco.getPredefinedDictionary(known[name])
