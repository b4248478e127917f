"""``sculpt-data pose``: photographs or a video in, posed images out."""

import argparse
from pathlib import Path

from sculpt_framework.posing.options import CAMERAS, PosingOptions


def add_pose_command(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """The subcommand and its options."""
    usual = PosingOptions()
    pose = commands.add_parser("pose", help="find the cameras of a folder of photographs, or of a video")
    pose.add_argument("source", metavar="PHOTOS|VIDEO", type=Path, help="folder of photographs, or a video file")
    out = "folder for images and cameras; given again, it is resumed"
    pose.add_argument("--out", type=Path, metavar="SCENE", required=True, help=out)
    lens = f"which photographs of the same size share a lens (default: {usual.cameras})"
    pose.add_argument("--cameras", choices=CAMERAS, default=usual.cameras, help=lens)
    frames = f"of a video, how many to take: the sharpest, evenly along the way (default: {usual.frames})"
    pose.add_argument("--frames", type=int, default=usual.frames, metavar="N", help=frames)
    size = f"longest side at which features are looked for, in pixels (default: {usual.image_size})"
    pose.add_argument("--image-size", type=int, default=usual.image_size, metavar="N", help=size)
    features = f"most features of a photograph (default: {usual.features})"
    pose.add_argument("--features", type=int, default=usual.features, metavar="N", help=features)
    masks = "use features outside masks, too; they have to stand still with the object"
    pose.add_argument("--ignore-masks", action="store_true", help=masks)
    pose.add_argument("--seed", type=int, default=usual.seed, metavar="N", help=f"(default: {usual.seed})")
    pose.add_argument("--threads", type=int, metavar="N", help="(default: all cores this process may use)")


def pose_photographs(arguments: argparse.Namespace) -> list[str]:
    """Do it; the lines of what came of it. Raises SculptError."""
    options = PosingOptions(
        cameras=arguments.cameras,
        image_size=arguments.image_size,
        features=arguments.features,
        frames=arguments.frames,
        ignore_masks=arguments.ignore_masks,
        seed=arguments.seed,
        threads=arguments.threads,
    )
    from sculpt_framework.posing.console import ConsoleAnnouncer
    from sculpt_framework.posing.pose import PICTURE, pose

    with ConsoleAnnouncer() as announcer:
        outcome = pose(arguments.source, arguments.out, options, announcer)
    return [*outcome.lines(arguments.out), f"picture    {arguments.out / PICTURE}"]
