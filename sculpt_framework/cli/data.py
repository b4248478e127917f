"""``sculpt-data``: write demo scenes, look at a scene before training on it."""

import argparse
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sculpt_framework import registry
from sculpt_framework.cli import data_markers, exit_codes
from sculpt_framework.cli.data_pose import add_pose_command, pose_photographs
from sculpt_framework.cli.scene_folder import open_folder
from sculpt_framework.ranges import require
from sculpt_framework.viewing.address import PORT

if TYPE_CHECKING:
    import numpy as np

    from sculpt_framework.types import Scene, View


def main() -> None:
    """The console script ``sculpt-data``."""
    exit_codes.run(data)


def data() -> None:
    """Parse and do it. Raises SculptError; exits as argparse does for unknown options."""
    arguments = _parser().parse_args()
    if arguments.command == "demo":
        write_demo(arguments.name, arguments.folder, arguments.views, arguments.test_views, arguments.resolution)
    elif arguments.command == "list":
        _say(demo_list())
    elif arguments.command == "masks":
        _say(write_masks(arguments.folder, arguments.out, arguments.downscale))
    elif arguments.command == "depths":
        _say(write_depth_maps(arguments.folder, arguments.out, arguments.pixels, arguments.downscale))
    elif arguments.command in data_markers.COMMANDS:
        _say(data_markers.run_command(arguments))
    elif arguments.command == "box":
        _say([choose_box(arguments.folder, arguments.port, arguments.downscale)])
    elif arguments.command == "pose":
        _say(pose_photographs(arguments))
    else:
        _say(inspect(arguments.folder, arguments.picture, arguments.downscale))


def write_demo(name: str, folder: Path, views: int, test_views: int, resolution: int) -> None:
    """Render a demo scene into a new or empty folder. Raises DataError, ConfigError, OutputError."""
    from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
    from sculpt_framework.demo_scenes.limits import RESOLUTION, TEST_VIEWS, TRAIN_VIEWS
    from sculpt_framework.demo_scenes.objects import demo_object

    sizes = (
        ("views", views, TRAIN_VIEWS),
        ("test-views", test_views, TEST_VIEWS),
        ("resolution", resolution, RESOLUTION),
    )
    for option, value, limits in sizes:
        require(value in limits, option, value, str(limits))
    settings = DemoSettings(train_views=views, test_views=test_views, resolution=resolution)
    item = demo_object(name)
    live = sys.stderr.isatty()

    def progress(done: int, total: int) -> None:
        if live:
            sys.stderr.write(f"\rrendering {done}/{total}" + ("\n" if done == total else ""))
            sys.stderr.flush()

    write_scene(item, settings, folder, progress)
    _say([f"{folder}: {views} train and {test_views} test views of '{name}', {resolution}x{resolution}, gt_mesh.ply"])


def demo_list() -> list[str]:
    """One line per demo scene."""
    from sculpt_framework.demo_scenes.objects import DEFAULT, OBJECTS

    width = max(len(name) for name in OBJECTS)
    return [f"{n:{width}}  {item.summary}{' (what demo means)' * (n == DEFAULT)}" for n, item in OBJECTS.items()]


def inspect(folder: str, picture: Path | None = None, downscale: int | None = None) -> list[str]:
    """The lines of a scene's card; also a picture of it where one is asked for. Raises DataError, OutputError."""
    from sculpt_framework.frame import frame_of
    from sculpt_framework.posed_images.findings import findings

    scene = open_folder(folder, downscale).load()
    frame = frame_of(scene, folder)
    told = [] if frame is None else [f"frame      {frame.in_words()}"]
    lines = [*scene_card(scene), *told, *(f"look at    {line}" for line in findings(scene))]
    if picture is not None:
        from sculpt_framework.posed_images.contact_sheet import contact_sheet

        _write_picture(picture, contact_sheet(scene))
        lines.append(f"picture    {picture}")
    return lines


def choose_box(folder: str, port: int, downscale: int | None) -> str:
    """Show the box of a scene in the browser until a person is content with it, and return it as an option for a run.

    Raises DataError, ConfigError.
    """
    from sculpt_framework.errors import DataError
    from sculpt_framework.viewing.address import HOST, announce, check_address
    from sculpt_framework.viewing.box_page import BoxPage

    check_address(HOST, port, "--port")
    # Layouts without such an option say so now.
    open_folder(folder, downscale, box=(-1.0, -1.0, -1.0, 1.0, 1.0, 1.0))
    try:
        scene = open_folder(folder, downscale).load()
    except DataError as error:
        scene = open_folder(folder, downscale, masks="none").load()
        sys.stderr.write(f"note: the box is that of the cameras alone; {error}\n")
    page = BoxPage(scene, HOST, port)
    announce(HOST, page.port)
    try:
        page.wait()
        return page.words
    finally:
        page.close()


def write_masks(folder: str, out: Path, downscale: int | None) -> list[str]:
    """Masks of all views as they would be used, or as the mesh of a finished run covers them, and a sheet of them.

    Raises DataError, OutputError, CheckpointError.
    """
    import numpy as np

    from sculpt_framework.errors import DataError
    from sculpt_framework.posed_images.contact_sheet import contact_sheet

    _check_new(out)
    scene = _outlined(Path(folder), downscale) if _is_run(folder) else open_folder(folder, downscale).load()
    masked = [view for view in (*scene.train, *scene.test) if view.alpha is not None]
    if not masked:
        raise DataError(f"{folder}: no view has a mask, and none was made.")
    # The folder of the images is no part of a mask's name: that is how masks are looked for. Several folders are.
    inside = {view.name: Path(*(Path(view.name).parts[1:] or Path(view.name).parts)) for view in masked}
    if len(set(inside.values())) < len(masked):
        inside = {view.name: Path(view.name) for view in masked}
    for view in masked:
        assert view.alpha is not None  # noqa: S101
        pixels = np.rint(view.alpha.numpy() * 255).astype(np.uint8)
        _write_picture(out / f"{inside[view.name]}.png", np.repeat(pixels[..., None], 3, axis=2))
    sheet = _sheet_of(out)
    _write_picture(sheet, contact_sheet(scene))
    return [
        f"{out}: {len(masked)} masks",
        f"{sheet}: the masks over their images",
        *(f"note: {n}" for n in scene.notes),
    ]


def _is_run(folder: str) -> bool:
    from sculpt_framework.engine.run import CONFIG_NAME

    return (Path(folder) / CONFIG_NAME).is_file()


def _outlined(run: Path, downscale: int | None) -> "Scene":
    """The scene of a run, with the outlines of its mesh for masks."""
    from sculpt_framework.engine.run import MESH_NAME, load_finished
    from sculpt_framework.errors import ConfigError
    from sculpt_framework.evaluation.mesh import load_mesh
    from sculpt_framework.export.outlines import covered_by

    if downscale is not None:
        raise ConfigError(f"--downscale: the masks of a run have the size of its images; give the scene, not {run}.")
    scene, mesh = load_finished(run).scene, load_mesh(run / MESH_NAME)
    train, test = (covered_by(mesh.vertices, mesh.faces, views) for views in (scene.train, scene.test))
    return replace(scene, train=tuple(train), test=tuple(test))


def write_depth_maps(folder: str, out: Path, pixels: int, downscale: int | None) -> list[str]:
    """Depths, normals and confidence of all train views, and a sheet. Raises ConfigError, DataError, OutputError."""
    import numpy as np
    from rich.console import Console
    from rich.progress import Progress

    from sculpt_framework.errors import ConfigError
    from sculpt_framework.multi_view_stereo.depth_maps import StereoOptions
    from sculpt_framework.multi_view_stereo.files import depth_sheet, scene_depths, write_depths

    usual = _stereo_defaults()
    if pixels < 1:
        raise ConfigError(f"--pixels {pixels}: expected 1 or more; leave it out for {usual['pixels']}.")
    _check_new(out)
    options = StereoOptions(pixels=pixels, neighbours=usual["neighbours"], agreeing=usual["agreeing"])
    scene = open_folder(folder, downscale).load()
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("finding depths", total=1.0)
        found = scene_depths(scene, options, usual["cells"], lambda share: progress.update(task, completed=share))
    for each in found:
        write_depths(each, out)
    sheet = _sheet_of(out)
    _write_picture(sheet, depth_sheet(found))
    known = np.concatenate([each.known.reshape(-1) for each in found]).mean()
    return [
        f"{out}: depths of {len(found)} views, known at {100 * known:.0f} % of their pixels",
        f"{sheet}: images, depths and confidence",
        *(f"note: {n}" for n in scene.notes),
    ]


def _stereo_defaults() -> Mapping[str, int]:
    return vars(registry.default("initializer", "stereo"))


def _check_new(folder: Path) -> None:
    from sculpt_framework.errors import OutputError

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{folder}: exists and is not empty; give a new or an empty folder with --out.")


def _sheet_of(out: Path) -> Path:
    """Beside the folder, whatever it is called: ``.`` has no name."""
    whole = Path(os.path.abspath(out))
    return whole.with_name(f"{whole.name}-sheet.png")


def _write_picture(path: Path, pixels: "np.ndarray") -> None:
    import cv2
    import numpy as np

    from sculpt_framework.errors import OutputError
    from sculpt_framework.export.atomic import write_atomically

    done, data = cv2.imencode(".png", np.ascontiguousarray(pixels[:, :, ::-1]))
    if not done:
        raise ValueError("the picture cannot be encoded")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {path} ({error.strerror}); choose another place.") from error
    write_atomically(path, data.tobytes())


def scene_card(scene: "Scene") -> list[str]:
    """What there is to know about a scene before training on it, one fact a line."""
    sides = " x ".join(f"{side:.3g}" for side in (scene.box.maximum - scene.box.minimum).tolist())
    middle = " ".join(f"{value:.3g}" for value in scene.box.center.tolist())
    return [
        f"scene      {scene.name}",
        f"train      {_views(scene.train)}",
        f"test       {_views(scene.test)}",
        f"box        {sides} around ({middle})",
        f"reference  {scene.reference_mesh or 'none'}",
        *(f"note       {note}" for note in scene.notes),
    ]


def _views(views: "Sequence[View]") -> str:
    if not views:
        return "none"
    sizes = sorted({(view.camera.width, view.camera.height) for view in views})
    size = f"{sizes[0][0]}x{sizes[0][1]}" + (f" to {sizes[-1][0]}x{sizes[-1][1]}" if len(sizes) > 1 else "")
    masked = sum(view.alpha is not None for view in views)
    alpha = "with alpha" if masked == len(views) else "without alpha" if masked == 0 else f"{masked} with alpha"
    return f"{len(views)} {'view' if len(views) == 1 else 'views'}, {size}, {alpha}"


def _say(lines: Iterable[str]) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="sculpt-data", description="Demo scenes, and a look at your own.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    demo = commands.add_parser("demo", help="write a demo scene as a folder in NeRF-Synthetic layout")
    demo.add_argument("name", metavar="NAME", help="one of sculpt-data list")
    demo.add_argument("folder", metavar="DIR", type=Path, help="new or empty folder")
    demo.add_argument("--views", type=int, default=100, metavar="N", help="train images (default: 100)")
    demo.add_argument("--test-views", type=int, default=20, metavar="N", help="test images (default: 20)")
    demo.add_argument("--resolution", type=int, default=400, metavar="R", help="side in pixels (default: 400)")
    commands.add_parser("list", help="name the demo scenes")
    card = commands.add_parser("inspect", help="print what is in a scene, and what is unusual about it")
    card.add_argument("folder", metavar="DIR", help="scene folder, or demo:NAME")
    card.add_argument("--picture", type=Path, metavar="FILE", help="also a PNG of cameras, box, images and masks")
    box = commands.add_parser("box", help="choose the box that a run works in, in the browser; print it as an option")
    box.add_argument("folder", metavar="DIR", help="scene folder")
    box.add_argument("--port", type=int, default=PORT, metavar="N", help="of the page (default: %(default)s)")
    masks = commands.add_parser("masks", help="write the masks a run would use, or those a finished run ended with")
    masks.add_argument("folder", metavar="DIR", help="scene folder, or the folder of a finished run")
    masks.add_argument("--out", type=Path, metavar="FOLDER", required=True, help="new or empty folder")
    depths = commands.add_parser("depths", help="write depths, normals and confidence found by multi-view stereo")
    depths.add_argument("folder", metavar="DIR", help="scene folder, or demo:NAME")
    depths.add_argument("--out", type=Path, metavar="FOLDER", required=True, help="new or empty folder")
    pixels = _stereo_defaults()["pixels"]
    size = f"along the object's longest side, at most (default: {pixels}); never finer than the images"
    depths.add_argument("--pixels", type=int, default=pixels, metavar="N", help=size)
    add_pose_command(commands)
    data_markers.add_commands(commands)
    for command in (card, box, masks, depths):
        command.add_argument("--downscale", type=int, metavar="N", help="read images at 1/N of their sides")
    return parser


if __name__ == "__main__":
    main()
