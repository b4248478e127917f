"""A board seen in posed photographs: where its points are in the world, and how it lies there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8

from sculpt_framework.errors import DataError
from sculpt_framework.markers.boards import MILLIMETRE, Board
from sculpt_framework.markers.detection import Sighting, find_board
from sculpt_framework.markers.shrinking import without_shrinking
from sculpt_framework.markers.similarity import Similarity, fit_similarity
from sculpt_framework.markers.triangulation import SpacePoints, triangulate
from sculpt_framework.types import Camera

_UNFIT, _UNFIT_SINGLE = 0.01, 0.03
"""A board whose points are this far off, in lengths of its diagonal, is another board, or was not at rest. A single
marker is no longer used, as it may be partly hidden."""
_SHARE = 0.5
"""Of a board's points in space that must fit, and of its cameras that must stand before it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardInSpace:
    board: Board
    points: SpacePoints
    views: int
    """Photographs that show it."""
    markers: int
    """Different ones that are seen."""
    scale: float
    """World units per metre."""
    scale_error: float
    """Standard error, relative."""
    residual: float
    """Root mean square distance of the points from the board's, in metres."""
    fitting: int
    """Points that fit."""
    plane: Similarity | None
    """Where it lies; None of single markers, of which each lies where it likes."""

    @property
    def normal(self) -> Float64[np.ndarray, " 3"] | None:
        """Unit, world axes, to the side that is printed."""
        return None if self.plane is None else self.plane.rotation[:, 2]

    @property
    def agreed(self) -> float:
        """Share of what the photographs show of it that fits together."""
        return self.points.used / self.points.seen

    def in_words(self) -> str:
        there = len(self.board.marker_centers())
        return (
            f"{self.board.name}: {self.markers} of {there} markers in {self.views} photographs; {self.fitting} of "
            f"{len(self.board.points())} points fit, {self.residual / MILLIMETRE:.2g} mm off (rms), "
            f"{self.points.pixel_error:.2g} pixels in the photographs"
        )


def board_in_space(board: Board, cameras: Sequence[Camera], sightings: Sequence[Sighting]) -> BoardInSpace:
    """Raises DataError, which says what is wrong, where photographs and board do not fit together."""
    check_sightings(board, sightings)
    given = board.points()
    points = triangulate(cameras, sightings, len(given))
    placed = int(np.isfinite(points.places).all(axis=1).sum())
    few = f"{board.name}: {placed} of its {len(given)} points could be placed in space"
    if placed < 4:
        raise DataError(
            f"{few}, from {points.seen} seen in {_showing(sightings)} photographs; expected four that two photographs "
            "agree on from different sides. Take photographs in which the board is larger and sharp, and not moved."
        )
    single = board.kind == "single"
    fits = _of_singles(given, points.places) if single else [fit_similarity(given, points.places)]
    there = [fit for fit in fits if fit is not None]
    limit = _UNFIT_SINGLE * _diagonal(given[:4]) if single else _UNFIT * _diagonal(given)
    good = [fit for fit in there if fit.residual <= limit]
    fitting = sum(int(fit.used.sum()) for fit in good)
    if not good or (not single and fitting < _SHARE * placed):
        off = f", {min(fit.residual for fit in there) / MILLIMETRE:.1f} mm off (rms)" if there else ""
        raise DataError(
            f"{few}, but they do not lie as on that board ({fitting} fit{off}): another board was printed, it is bent, "
            "or it was moved against what the cameras were found from."
        )
    plane = None if single else good[0]
    if plane is not None:
        _check_side(board, plane, [c for c, s in zip(cameras, sightings, strict=True) if len(s.points)])
    scales = np.array([fit.scale for fit in good])
    own = float(np.mean([fit.scale_error for fit in good]))
    apart = float(scales.std(ddof=1) / scales.mean()) if len(good) > 1 else 0.0
    return BoardInSpace(
        board=board,
        points=points,
        views=_showing(sightings),
        markers=_markers(board, sightings),
        scale=float(scales.mean()),
        scale_error=max(own, apart) / np.sqrt(len(good)),
        residual=float(np.sqrt(np.mean([fit.residual**2 for fit in good]))),
        fitting=fitting,
        plane=plane,
    )


def find_in_all(
    count: int, read: Callable[[int], UInt8[np.ndarray, "h w"]], board: Board, progress: Callable[[float], None]
) -> list[Sighting]:
    """The board in each of so many photographs, in threads; ``progress`` hears which share is done."""
    # What imports torch is imported where it is needed.
    from sculpt_framework.threads import in_threads

    done: list[int] = []

    def one(index: int) -> Sighting:
        sighting = find_board(read(index), board)
        done.append(index)
        progress(len(done) / count)
        return sighting

    found = in_threads(one, range(count))
    return without_shrinking(board, found) if board.kind == "ring" else found


def check_sightings(board: Board, sightings: Sequence[Sighting]) -> None:
    """Raises DataError where no photograph shows the board, with the reason if it is plain."""
    mirrored = sum(sighting.mirrored for sighting in sightings)
    twice = [sighting.repeated for sighting in sightings if sighting.repeated]
    if _showing(sightings) >= 2 and len(twice) <= _SHARE * len(sightings):
        return
    if mirrored > _showing(sightings):
        raise DataError(
            f"{board.name}: its markers are seen as in a mirror, in {mirrored} of {len(sightings)} photographs: the "
            "print or the photographs are mirrored. Print it again, or take photographs that the camera does not flip."
        )
    if twice:
        numbers = ", ".join(str(number) for number in twice[0][:4])
        raise DataError(
            f"{board.name}: the same markers (such as {numbers}) are seen more than once in {len(twice)} of "
            f"{len(sightings)} photographs. Use one print of each board; a second one with numbers of its own: "
            f"{board.name.partition('@')[0]}@{board.first + len(board.ids)}."
        )
    raise DataError(
        f"{board.name}: seen in {_showing(sightings)} of {len(sightings)} photographs; expected two or more. Is that "
        "the name printed on the sheet, and are the markers whole, sharp and 20 pixels wide or more?"
    )


def _showing(sightings: Sequence[Sighting]) -> int:
    return sum(len(sighting.points) > 0 for sighting in sightings)


def _markers(board: Board, sightings: Sequence[Sighting]) -> int:
    """Of a ChArUco board, the most in one photograph: its points are not those of single markers."""
    if board.kind == "charuco":
        return max(sighting.markers for sighting in sightings)
    return len(np.unique(np.concatenate([sighting.points // 4 for sighting in sightings])))


def _of_singles(given: Float64[np.ndarray, "n 3"], places: Float64[np.ndarray, "n 3"]) -> list[Similarity | None]:
    return [fit_similarity(given[at : at + 4], places[at : at + 4]) for at in range(0, len(given), 4)]


def _diagonal(points: Float64[np.ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _check_side(board: Board, plane: Similarity, cameras: Sequence[Camera]) -> None:
    heights = np.array([(c.position.double().numpy() - plane.translation) @ plane.rotation[:, 2] for c in cameras])
    if (heights > 0).mean() < _SHARE:
        raise DataError(
            f"{board.name}: {(heights <= 0).sum()} of the {len(heights)} cameras that see it stand behind it: their "
            "poses are mirrored, or in other axes than the layout has."
        )
