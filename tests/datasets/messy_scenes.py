"""One small scene in every layout, with masks in files, for tests to make a mess of."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from layouts import (
    make_shots,
    write_blender,
    write_colmap,
    write_idr,
    write_nerfstudio,
)
from plain_scenes import write_image

from sculpt_framework.types import Scene
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig

Write = Callable[..., Path]
SHOTS = make_shots(6, 32)
BOX = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)


def read(folder: Path, **options: Any) -> Scene:
    """With the box given, which takes most of the time to find, where the layout has the option."""
    if not (folder / "transforms_train.json").is_file() and not (folder / "render").is_dir():
        options.setdefault("box", BOX)
    return AutoDatasetConfig(**options).build(str(folder)).load()


def noted(scene: Scene, text: str) -> bool:
    return any(text in note for note in scene.notes)


def edit(folder: Path, change: Callable[[dict[str, Any]], object], name: str = "transforms.json") -> None:
    document = json.loads((folder / name).read_text(encoding="utf-8"))
    change(document)
    (folder / name).write_text(json.dumps(document), encoding="utf-8")


def text_model(folder: Path, **options: Any) -> Path:
    return write_colmap(folder, SHOTS, text=True, **options)


def binary_model(folder: Path, **options: Any) -> Path:
    return write_colmap(folder, SHOTS, **options)


def transforms(folder: Path) -> Path:
    """Without masks that are named, so that they are looked for."""
    write_nerfstudio(folder, SHOTS)
    edit(folder, lambda d: [frame.pop("mask_path") for frame in d["frames"]])
    return folder


def synthetic(folder: Path) -> Path:
    """NeRF-Synthetic with masks in files."""
    write_blender(folder, SHOTS)
    (folder / "masks").mkdir()
    for shot in SHOTS:
        write_image(folder / "train" / f"{shot.name}.png", shot.image[..., :3])
        write_image(folder / "masks" / f"{shot.name}.png", shot.image[..., 3])
    return folder


def idr(folder: Path) -> Path:
    return write_idr(folder, SHOTS)


MASKED = {"COLMAP text": text_model, "COLMAP": binary_model, "nerfstudio": transforms, "Blender": synthetic, "IDR": idr}
every_layout = pytest.mark.parametrize("write", MASKED.values(), ids=MASKED.keys())


def mask_folder(folder: Path) -> Path:
    return folder / ("mask" if (folder / "mask").is_dir() else "masks")


def image_folder(folder: Path) -> Path:
    return next(folder / name for name in ("images", "image", "train") if (folder / name).is_dir())


def has_the_masks(scene: Scene) -> bool:
    truths = [shot.image[..., 3] > 0 for shot in SHOTS]
    return len(scene.train) == len(SHOTS) and all(
        view.alpha is not None and ((view.alpha.numpy() > 0.5) == truth).mean() > 0.98
        for view, truth in zip(scene.train, truths, strict=True)
    )
