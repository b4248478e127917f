"""``sculpt-data markers``, ``scale`` and ``pose-board``: printed boards, and what they say of photographs."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from sculpt_framework.cli.scene_folder import open_folder
from sculpt_framework.errors import ConfigError, DataError

if TYPE_CHECKING:
    from sculpt_framework.markers.boards import Board

COMMANDS = ("markers", "scale", "pose-board")
_DEFAULT_BOARD = "charuco-7x9-26"
_PAPERS = ("a4", "letter", "a3", "tabloid")
_DICTIONARY = "apriltag_36h11"
_BOARD = "charuco-7x9-26, ring-5x6-30, single-6-40, ...: kind, how many, side in mm; as printed on the sheet"
_RULER = "what the sheet's ruler of 100 mm measures, where it is not 100"


def add_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """The parsers of these commands."""
    sheet = commands.add_parser("markers", help="write a sheet to print: a board, a ring of markers, or single markers")
    sheet.add_argument("--out", type=Path, metavar="FILE.pdf", required=True, help="where to write it")
    sheet.add_argument("--board", metavar="NAME", default=_DEFAULT_BOARD, help=f"{_BOARD} (default: %(default)s)")
    sheet.add_argument("--paper", choices=_PAPERS, default="a4", help="(default: %(default)s)")
    scale = commands.add_parser("scale", help="find metres and up of a scene; write its frame.json")
    scale.add_argument("folder", metavar="DIR", help="scene folder")
    scale.add_argument("--board", metavar="NAME", action="append", default=[], help=f"{_BOARD}; may be repeated")
    scale.add_argument("--ruler", type=float, metavar="MM", default=100.0, help=_RULER)
    bar = "A B METRES: two markers' numbers and their distance; or two points of the world: X Y Z X Y Z METRES"
    scale.add_argument("--scale-bar", nargs="+", type=float, metavar="N", action="append", default=[], help=bar)
    named = "of markers in --scale-bar that are on no --board (default: %(default)s)"
    scale.add_argument("--dictionary", metavar="NAME", default=_DICTIONARY, help=named)
    scale.add_argument("--up", nargs=3, type=float, metavar=("X", "Y", "Z"), help="up in the world, where you know it")
    scale.add_argument("--downscale", type=int, metavar="N", help="read images at 1/N of their sides")
    pose = commands.add_parser("pose-board", help="cameras of photographs from a board that they show; write a scene")
    pose.add_argument("folder", metavar="PHOTOGRAPHS", help="folder of images")
    pose.add_argument("--board", metavar="NAME", required=True, help=_BOARD)
    pose.add_argument("--ruler", type=float, metavar="MM", default=100.0, help=_RULER)
    pose.add_argument("--out", type=Path, metavar="DIR", required=True, help="new scene folder, or that of the images/")
    focal = "the lens's focal length in pixels, where you know it; else it is calibrated on the board"
    pose.add_argument("--focal", type=float, metavar="PIXELS", help=focal)


def run_command(arguments: argparse.Namespace) -> list[str]:
    """What the command has to say. Raises SculptError."""
    if arguments.command == "markers":
        return write_sheet(arguments.out, arguments.board, arguments.paper)
    if arguments.command == "pose-board":
        return pose_board(arguments)
    return find_scale(arguments)


def write_sheet(out: Path, name: str, paper: str) -> list[str]:
    """Write the PDF of a board. Raises ConfigError, OutputError."""
    from sculpt_framework.markers.boards import board_of
    from sculpt_framework.markers.sheets import draw_sheet, write_sheet

    board = board_of(name)
    write_sheet(out, draw_sheet(board, paper))
    lines = [f"{out}: {board.name} on {paper}; print at 100 %, and measure the ruler: it is 100 mm long"]
    if board.free is not None:
        lines.append(f"free place in the middle: {board.free[0]:g} x {board.free[1]:g} mm")
    return lines


def find_scale(arguments: argparse.Namespace) -> list[str]:
    """Write ``frame.json`` into a scene's folder. Raises ConfigError, DataError, OutputError."""
    from sculpt_framework.frame import FRAME_NAME, frame_of, write_frame
    from sculpt_framework.markers.scale import measure_frame, scale_bar, with_what_was_known

    boards = printed_boards(arguments.board, arguments.ruler)
    bars = [scale_bar(values) for values in arguments.scale_bar]
    up = arguments.up
    if up is not None and not 0 < sum(value * value for value in up) < float("inf"):
        raise ConfigError(f"--up {' '.join(f'{value:g}' for value in up)}: expected a direction, not all 0.")
    if not Path(arguments.folder).is_dir():
        raise DataError(
            f"{arguments.folder}: no such folder; expected a scene's, in which frame.json is written. sculpt-data demo "
            "writes a built-in scene as a folder."
        )
    by_markers = bool(boards or bars)
    # What the object stands on is found together with its masks.
    masks = "none" if by_markers or up is not None else "ignored"
    try:
        dataset = open_folder(arguments.folder, arguments.downscale, masks=masks)
    except ConfigError:
        # A layout whose images have an alpha of their own has no such option.
        dataset = open_folder(arguments.folder, arguments.downscale)
    scene = dataset.load()
    with told_progress("looking for markers", quiet=not by_markers) as progress:
        measured = measure_frame(scene, boards, bars, arguments.dictionary, up, progress)
    before = None
    if (Path(arguments.folder) / FRAME_NAME).is_file():
        try:
            before = frame_of(scene, arguments.folder)
        except DataError as error:
            measured.lines.append(f"note: replaced: {error}")
    if before is not None:
        measured = with_what_was_known(measured, before)
    frame = measured.frame
    if frame.metres_per_unit is None and frame.up is None:
        raise DataError(
            f"{arguments.folder}: nothing says what metres and up are, and no plane that the object stands on is "
            "found. Give --board with the name printed on a sheet that the photographs show, --scale-bar, or --up."
        )
    path = write_frame(frame, Path(arguments.folder))
    read = [note for note in scene.notes if note.startswith("images are read at 1/")] if by_markers else []
    return [*measured.lines, *(f"note: {note}" for note in read), f"{path}: written; runs on this scene take it over"]


def pose_board(arguments: argparse.Namespace) -> list[str]:
    """Write the scene of photographs that show a board. Raises ConfigError, DataError, OutputError."""
    from sculpt_framework.markers.photographs import list_photographs
    from sculpt_framework.markers.scene_files import check_scene_folder, write_scene
    from sculpt_framework.markers.turntable import pose_by_board

    (board,) = printed_boards([arguments.board], arguments.ruler)
    if arguments.focal is not None and not 1 <= arguments.focal <= 1e6:
        raise ConfigError(f"--focal {arguments.focal:g}: expected pixels, such as 3000.")
    check_scene_folder(arguments.out, Path(arguments.folder))
    photographs = list_photographs(arguments.folder)
    with told_progress("looking for the board") as progress:
        found = pose_by_board(photographs, board, arguments.focal, progress)
    write_scene(arguments.out, found.posed, board)
    width, height = board.free or (board.width, board.height)
    half = f"{width / 2000:.3g} {height / 2000:.3g}"
    box = f"-{half.replace(' ', ' -')} 0.001 {half} {max(width, height) / 1000:.3g}"
    return [
        *found.lines,
        f"{arguments.out}: a scene in metres, z up, the board's middle at the origin",
        f"an object on the board is in --dataset.box {box}, if it is not higher",
    ]


def printed_boards(names: list[str], ruler: float) -> "list[Board]":
    """Boards as they are on paper. Raises ConfigError."""
    from sculpt_framework.markers.boards import board_of

    if not 50 <= ruler <= 200:
        raise ConfigError(f"--ruler {ruler:g}: expected the length in millimetres of the ruler that is 100 mm long.")
    boards = [board_of(name).printed_at(ruler) for name in names]
    for index, board in enumerate(boards):
        for other in boards[:index]:
            if other.dictionary == board.dictionary and set(other.ids.tolist()) & set(board.ids.tolist()):
                raise ConfigError(
                    f"--board {board.name} and --board {other.name} have markers in common; print one of them with "
                    f"numbers of its own: {board.name.partition('@')[0]}@{other.first + len(other.ids)}."
                )
    return boards


@contextmanager
def told_progress(what: str, *, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A bar on a terminal, moved by the share that is done."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as progress:
        task = progress.add_task(what, total=1.0)
        yield lambda share: progress.update(task, completed=share)
