"""Metres per world unit and up, from boards, scale bars, or what the user says."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.frame import WorldFrame, cameras_told
from sculpt_framework.markers.board_in_space import BoardInSpace, board_in_space, find_in_all
from sculpt_framework.markers.boards import MILLIMETRE, Board, board_of
from sculpt_framework.markers.detection import Sighting
from sculpt_framework.markers.triangulation import triangulate
from sculpt_framework.types import Scene, View

_APART, _TILTED = 0.005, 2.0
"""Two scales, relative, and two normals, in degrees, that differ by more are told."""
_AGREED, _PIXELS = 0.8, 3.0
"""Share of what photographs show of a board that fits together at least, and pixels by which it is off at most: else it
is told."""
_GREY = (0.299, 0.587, 0.114)
End = int | tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class ScaleBar:
    ends: tuple[End, End]
    """Numbers of markers, whose middles count, or points in the world."""
    metres: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredFrame:
    frame: WorldFrame
    lines: list[str]


def scale_bar(values: Sequence[float]) -> ScaleBar:
    """From the numbers of ``--scale-bar``: A B METRES, or X Y Z X Y Z METRES. Raises ConfigError."""
    where = f"--scale-bar {' '.join(f'{value:g}' for value in values)}"
    if len(values) not in (3, 7) or not np.isfinite(values).all():
        raise ConfigError(f"{where}: expected two markers' numbers, or two points X Y Z, and then metres.")
    if not values[-1] > 0:
        raise ConfigError(f"{where}: expected a length in metres, more than 0.")
    ends: tuple[End, End]
    if len(values) == 3:
        if any(value < 0 or value != int(value) for value in values[:2]):
            raise ConfigError(f"{where}: markers have whole numbers; two points are X Y Z each.")
        ends = (int(values[0]), int(values[1]))
    else:
        ends = ((values[0], values[1], values[2]), (values[3], values[4], values[5]))
    if ends[0] == ends[1]:
        raise ConfigError(f"{where}: both ends are the same.")
    return ScaleBar(ends=ends, metres=values[-1])


def measure_frame(
    scene: Scene,
    boards: Sequence[Board],
    bars: Sequence[ScaleBar],
    dictionary: str,
    up: tuple[float, float, float] | None,
    progress: Callable[[float], None],
) -> MeasuredFrame:
    """The world frame of a scene. What the user says goes before what is measured; bars go before boards.

    ``dictionary`` is that of markers which bars name and no board has. Raises DataError where nothing can be measured.
    """
    views = [*scene.train, *scene.test]
    found, failures = _find_boards(views, boards, progress)
    lengths = [_bar_length(bar, views, [*boards, *_own_markers(bars, boards, dictionary)]) for bar in bars]
    lines = [each.in_words() for each in found] + [f"note: {failure}" for failure in failures]
    evidence: dict[str, object] = {"boards": [_told(each) for each in found]} if found else {}
    metres, error = _by_boards(found)
    if bars:
        sizes, units = np.array([bar.metres for bar in bars]), np.array(lengths)
        by_bars = float((sizes * units).sum() / (units**2).sum())
        apart = float(np.abs(sizes / units / by_bars - 1).max())
        lines += [f"{len(bars)} scale bars: {by_bars:.6g} m per world unit, at most {100 * apart:.2g} % off"]
        if metres is not None and abs(metres / by_bars - 1) > _APART:
            lines += [f"note: boards say {metres:.6g} m per world unit; the bars' is taken."]
        metres, error = by_bars, apart if len(bars) > 1 else None
    lines += [*_doubts(found), *_disagreements(found)]
    direction, up_from, tilt = _up(scene, found, up)
    if metres is not None:
        sure = "" if error is None else f" +- {100 * error:.2g} %"
        lines.append(f"one world unit is {metres:.6g} m{sure}")
        evidence |= {"scale_from": "scale bars" if bars else "boards", "scale_error": error}
    if direction is not None:
        sure = "" if tilt is None else f" +- {tilt:.2g} degrees"
        lines.append(f"up is ({', '.join(f'{value:.4f}' for value in direction)}){sure}, from {up_from}")
        evidence |= {"up_from": up_from, "up_error_degrees": tilt}
    plane = next((each.plane for each in found if each.plane is not None), None)
    if plane is not None:
        evidence["origin"] = plane.translation.tolist()
    evidence["cameras"] = cameras_told(views)
    return MeasuredFrame(frame=WorldFrame(metres_per_unit=metres, up=direction, evidence=evidence), lines=lines)


def with_what_was_known(measured: MeasuredFrame, before: WorldFrame) -> MeasuredFrame:
    """Metres and up that are not measured now stay as they were."""
    new, lines = measured.frame, list(measured.lines)
    metres, up = new.metres_per_unit, new.up
    if metres is None and before.metres_per_unit is not None:
        metres = before.metres_per_unit
        lines.append(f"one world unit stays {metres:.6g} m, as it was")
    if up is None and before.up is not None:
        up = before.up
        lines.append(f"up stays ({', '.join(f'{value:.4f}' for value in up)}), as it was")
    frame = WorldFrame(metres_per_unit=metres, up=up, evidence={**before.evidence, **new.evidence})
    return MeasuredFrame(frame=frame, lines=lines)


def grey_pixels(view: View) -> UInt8[np.ndarray, "h w"]:
    return (view.rgb @ torch.tensor(_GREY) * 255).round().clamp(0, 255).to(torch.uint8).numpy()


def _find_boards(
    views: Sequence[View], boards: Sequence[Board], progress: Callable[[float], None]
) -> tuple[list[BoardInSpace], list[str]]:
    """Those that could be placed, and why the others could not. Raises DataError where none could."""
    found, failures = [], []
    for index, board in enumerate(boards):
        sightings = _sightings(views, board, lambda share, at=index: progress((at + share) / len(boards)))
        try:
            found.append(board_in_space(board, [view.camera for view in views], sightings))
        except DataError as error:
            failures.append(str(error))
    if boards and not found:
        raise DataError(" ".join(failures))
    return found, failures


def _sightings(views: Sequence[View], board: Board, progress: Callable[[float], None]) -> list[Sighting]:
    return find_in_all(len(views), lambda index: grey_pixels(views[index]), board, progress)


def _by_boards(found: Sequence[BoardInSpace]) -> tuple[float | None, float | None]:
    """Metres per unit, and its relative standard error: means weighted by how sure each board is."""
    if not found:
        return None, None
    weights = np.array([1 / max(each.scale_error, 1e-6) ** 2 for each in found])
    metres = np.array([1 / each.scale for each in found])
    return float((weights * metres).sum() / weights.sum()), float(1 / np.sqrt(weights.sum()))


def _up(
    scene: Scene, found: Sequence[BoardInSpace], given: tuple[float, float, float] | None
) -> tuple[tuple[float, float, float] | None, str, float | None]:
    """The direction, what it is from, and its standard error in degrees."""
    if given is not None:
        return _unit(np.array(given)), "--up", None
    for each in found:
        if each.plane is not None:
            return _unit(each.plane.rotation[:, 2]), each.board.name, each.plane.tilt_error
    return scene.up, "the plane the object stands on", None


def _unit(vector: Float64[np.ndarray, " 3"]) -> tuple[float, float, float]:
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return (x, y, z)


def _doubts(found: Sequence[BoardInSpace]) -> list[str]:
    """Where photographs contradict each other."""
    return [
        f"note: of {each.board.name}, {100 * each.agreed:.0f} % of what the photographs show fits together, to "
        f"{each.points.pixel_error:.2g} pixels: it was moved, or some of the cameras are wrong."
        for each in found
        if each.agreed < _AGREED or each.points.pixel_error > _PIXELS
    ]


def _disagreements(found: Sequence[BoardInSpace]) -> list[str]:
    """Of the first board and each other."""
    lines = []
    for each in found[1:]:
        first = found[0]
        ratio = first.scale / each.scale
        if abs(ratio - 1) > max(_APART, 3 * (first.scale_error + each.scale_error)):
            lines.append(
                f"note: by {each.board.name} a world unit is {100 * (ratio - 1):+.2g} % longer than by "
                f"{first.board.name}: one of them is not printed in its size; measure the rulers."
            )
        if first.normal is not None and each.normal is not None:
            tilt = float(np.degrees(np.arccos(np.clip(first.normal @ each.normal, -1, 1))))
            if tilt > _TILTED:
                lines.append(
                    f"note: {each.board.name} is tilted by {tilt:.1f} degrees against {first.board.name}, whose "
                    "normal is taken for up."
                )
    return lines


def _told(each: BoardInSpace) -> Mapping[str, object]:
    return {
        "board": each.board.name,
        "side_mm": each.board.side,
        "photographs": each.views,
        "markers": each.markers,
        "points": each.fitting,
        "residual_mm": each.residual / MILLIMETRE,
        "residual_pixels": each.points.pixel_error,
        "metres_per_unit": 1 / each.scale,
        "scale_error": each.scale_error,
        "normal": None if each.normal is None else each.normal.tolist(),
    }


def _own_markers(bars: Sequence[ScaleBar], boards: Sequence[Board], dictionary: str) -> list[Board]:
    """Markers that bars name and no board has; their size does not matter."""
    named = {end for bar in bars for end in bar.ends if isinstance(end, int)}
    rest = sorted(named - {int(number) for board in boards for number in board.ids})
    return [board_of(f"single-1-10-{dictionary}@{number}") for number in rest]


def _bar_length(bar: ScaleBar, views: Sequence[View], boards: Sequence[Board]) -> float:
    """In world units. Raises DataError for a marker that could not be placed."""
    first, second = (_place(end, views, boards) for end in bar.ends)
    length = float(np.linalg.norm(first - second))
    if not length > 0:
        raise DataError("--scale-bar: both ends are at the same place.")
    return length


def _place(end: End, views: Sequence[View], boards: Sequence[Board]) -> Float64[np.ndarray, " 3"]:
    if not isinstance(end, int):
        return np.array(end)
    board = next(board for board in boards if end in board.ids)
    alone = replace(board, kind="single", columns=1, rows=1, side=board.marker, first=end)
    sightings = _sightings(views, alone, lambda _: None)
    corners = triangulate([view.camera for view in views], sightings, 4).places
    if not np.isfinite(corners).all():
        seen = sum(len(sighting.points) > 0 for sighting in sightings)
        raise DataError(
            f"--scale-bar: marker {end} ({board.dictionary}) could not be placed: seen in {seen} of {len(views)} "
            "photographs; expected two or more, from different sides."
        )
    return corners.mean(axis=0)
