"""Demo scenes on disk, in NeRF-Synthetic layout, and the cache of them."""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh

from sculpt_framework.demo_scenes.cameras import FIELD_OF_VIEW, Placement, demo_cameras
from sculpt_framework.demo_scenes.objects import DemoObject
from sculpt_framework.demo_scenes.reference import reference_mesh
from sculpt_framework.demo_scenes.tracing import render, surface_color
from sculpt_framework.errors import OutputError
from sculpt_framework.types import Camera
from sculpt_framework.user_cache import user_cache

Progress = Callable[[int, int], None]
"""Told how many of how many images are done."""

_OPENCV_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How a scene is rendered, within ``limits.py``."""

    train_views: int = 100
    test_views: int = 20
    resolution: int = 400
    """Side of the square images, in pixels."""
    reference_cells: int | None = None
    """Cells along the diameter of the unit ball when the reference mesh is extracted; None: as the object asks."""
    seen_from: Placement | None = None
    """Where cameras stand; None: as the object asks."""


def write_scene(item: DemoObject, settings: DemoSettings, folder: Path, progress: Progress | None = None) -> None:
    """Render a scene into a new folder with its reference mesh, ``gt_mesh.ply``.

    Everything is written beside ``folder`` and renamed at the end, so that a folder of that name is always complete.

    Raises OutputError if the folder exists and is not empty, or cannot be written.
    """
    folder = folder.absolute()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(f"{folder}: exists and is not empty; give a new or an empty folder.")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            _write(item, settings, aside, progress or (lambda done, total: None))
            aside.chmod(0o755)
            if folder.exists():
                folder.rmdir()  # Windows renames to no name that is taken.
            aside.replace(folder)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror}); choose another place.") from None


def cached_scene(item: DemoObject, settings: DemoSettings) -> Path:
    """The folder of a scene in the user's cache, rendered now if it is not there yet.

    Where the cache cannot be written the system's temporary folder takes its place.
    """
    chosen = "-".join(str(value) for value in asdict(settings).values())
    place = Path("demo") / f"{_revision()}-{chosen}" / item.name
    folder = user_cache() / place
    if (folder / "transforms_train.json").is_file():
        return folder
    try:
        write_scene(item, settings, folder)
    except OutputError:
        if (folder / "transforms_train.json").is_file():  # Another process was faster.
            return folder
        folder = Path(tempfile.mkdtemp(prefix="sculpt-")) / item.name
        write_scene(item, settings, folder)
    return folder


def _revision() -> str:
    """A digest of this package's source, so that pictures of an older version are never taken for this one's."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def _write(item: DemoObject, settings: DemoSettings, folder: Path, progress: Progress) -> None:
    placement = settings.seen_from or item.seen_from
    splits = {
        "train": demo_cameras(settings.train_views, settings.resolution, placement=placement),
        # Far along the sequence, where no train view is.
        "test": demo_cameras(settings.test_views, settings.resolution, offset=10_000, placement=placement),
    }
    jobs = []
    for split, cameras in splits.items():
        if cameras:
            (folder / split).mkdir()
            document = {"camera_angle_x": FIELD_OF_VIEW, "frames": _frames(split, cameras)}
            (folder / f"transforms_{split}.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
            jobs += [
                (lit_in(item, index), camera, folder / split / f"r_{index}.png") for index, camera in enumerate(cameras)
            ]
    with ThreadPoolExecutor(max_workers=torch.get_num_threads()) as pool:
        mesh = pool.submit(_write_mesh, item, settings.reference_cells or item.reference_cells, folder / "gt_mesh.ply")
        pictures = [pool.submit(_write_picture, *job) for job in jobs]
        try:
            for done, picture in enumerate(pictures, start=1):
                picture.result()
                progress(done, len(pictures))
            mesh.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _frames(split: str, cameras: Sequence[Camera]) -> list[dict[str, object]]:
    frames: list[dict[str, object]] = []
    for index, camera in enumerate(cameras):
        matrix = np.linalg.inv(camera.world_to_camera.numpy()) @ _OPENCV_TO_OPENGL
        frames.append({"file_path": f"./{split}/r_{index}", "transform_matrix": matrix.tolist()})
    return frames


def lit_in(item: DemoObject, index: int) -> DemoObject:
    """The object as it looks in the picture of this number."""
    if item.lamps_lit is None or index % item.lamps_lit[0] == item.lamps_lit[1]:
        return item
    return replace(item, gloss=0.0)


def _write_picture(item: DemoObject, camera: Camera, path: Path) -> None:
    rgb, alpha = render(item, camera)
    if item.backdrop is None:
        pixels = np.concatenate([rgb[..., ::-1], alpha[..., None]], axis=2)
    else:
        wall = np.array(item.backdrop, np.float32)
        pixels = (rgb * alpha[..., None] + wall * (1 - alpha[..., None]))[..., ::-1]
    done, encoded = cv2.imencode(".png", np.round(pixels * 255).astype(np.uint8))
    if not done:
        raise OSError(0, "the PNG encoder failed")
    path.write_bytes(encoded.tobytes())


def _write_mesh(item: DemoObject, cells: int, path: Path) -> None:
    vertices, faces = reference_mesh(item.distance, cells)
    colors = np.round(surface_color(item, vertices.T.astype(np.float32)) * 255).astype(np.uint8)
    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
    mesh.export(path, file_type="ply")
