"""The table of what can be recognised. A new layout is a row in it."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from sculpt_framework.datasets import Dataset
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.posed_images.folders import contents, scene_folder
from sculpt_framework.posed_images.options import PhotographsConfig
from sculpt_framework.posing.source import holds_photographs, is_video
from sculpt_framework.types import Scene

# Choosing among the plug-ins of its own slot is all this one does, so it names them; by their configs, which are cheap.
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.datasets.colmap.config import ColmapConfig
from sculpt_plugins.datasets.demo.config import DemoConfig
from sculpt_plugins.datasets.idr.config import IdrConfig
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig
from sculpt_plugins.datasets.omniobject3d.config import OmniObject3DConfig

FolderConfig = BlenderConfig | ColmapConfig | IdrConfig | NerfstudioConfig | OmniObject3DConfig


def _has_sparse_model(folder: Path) -> bool:
    places = [folder / "sparse", *(folder / "sparse").glob("[0-9]*"), folder / "colmap" / "sparse" / "0", folder]
    return any(
        (place / f"images{end}").is_file() and (place / f"cameras{end}").is_file()
        for place in places
        for end in (".bin", ".txt")
    )


@dataclass(frozen=True, kw_only=True)
class Layout:
    name: str
    mark: str
    """What a folder of this layout is recognised by, for people."""
    recognises: Callable[[Path], bool]
    config: FolderConfig


COLMAP = Layout(
    name="COLMAP",
    mark="sparse/0/images.bin or .txt",
    recognises=_has_sparse_model,
    config=ColmapConfig(),
)
LAYOUTS = (
    Layout(
        name="NeRF-Synthetic",
        mark="transforms_train.json",
        recognises=lambda folder: (folder / "transforms_train.json").exists(),
        config=BlenderConfig(),
    ),
    Layout(
        name="OmniObject3D",
        mark="render/transforms.json",
        # The folder "render" itself, too, but under no other name: transforms.json beside images is also nerfstudio's.
        recognises=lambda folder: (
            (folder / "render" / "transforms.json").is_file()
            or (folder.name == "render" and (folder / "transforms.json").is_file())
        ),
        config=OmniObject3DConfig(),
    ),
    Layout(
        name="IDR",
        mark="cameras.npz or cameras_sphere.npz",
        recognises=lambda folder: any((folder / f"cameras{end}.npz").is_file() for end in ("", "_sphere")),
        config=IdrConfig(),
    ),
    Layout(
        name="nerfstudio",
        mark="transforms.json",
        recognises=lambda folder: (folder / "transforms.json").is_file(),
        config=NerfstudioConfig(),
    ),
    # Last, as converters leave their COLMAP model beside what they make of it.
    COLMAP,
)


class AutoDataset(Dataset):
    def __init__(self, config: AutoDatasetConfig, data: str):
        """Raises DataError, with the layouts there are, if ``data`` is none of them."""
        if data == "demo" or data.startswith("demo:"):
            if config.downscale is not None:
                raise ConfigError("--dataset.downscale is for photographs; give a demo --dataset.resolution instead.")
            for option in _of_photographs(config):
                raise ConfigError(f"{option} is for photographs; demo scenes have masks of their own.")
            self._demo = DemoConfig().build(data)
            return
        self._demo = None
        self._unposed = _is_unposed(data)
        layout = COLMAP if self._unposed else recognise(data)
        self._note = f"layout: {layout.name} (there is {layout.mark})."
        chosen = layout.config if config.downscale is None else replace(layout.config, downscale=config.downscale)
        for option in _of_photographs(config):
            if not isinstance(chosen, PhotographsConfig):
                raise ConfigError(
                    f"{option} is for photographs; images of {layout.name} have an alpha channel instead."
                )
        if isinstance(chosen, PhotographsConfig):
            masks = chosen.masks if config.masks is None else config.masks
            chosen = replace(
                chosen,
                masks=masks,
                invert_masks=config.invert_masks,
                keep_support=config.keep_support,
                box=config.box,
            )
        self._chosen, self._data = chosen, data

    @property
    def lacks_cameras(self) -> bool:
        return self._demo is None and self._unposed

    def load(self) -> Scene:
        """Photographs without cameras are posed first, beside the data: ``data`` of the scene says where."""
        if self._demo is not None:
            return self._demo.load()
        if not self._unposed:
            scene = self._chosen.build(self._data).load()
            return replace(scene, notes=(self._note, *scene.notes))
        from sculpt_framework.posing.beside import pose_beside

        folder, note = pose_beside(Path(self._data).expanduser())
        scene = self._chosen.build(str(folder)).load()
        return replace(scene, notes=(note, *scene.notes), data=str(folder))


def _of_photographs(config: AutoDatasetConfig) -> list[str]:
    """The options given that only layouts of photographs have."""
    given = {
        "masks": config.masks is not None,
        "invert-masks": config.invert_masks != "auto",
        "keep-support": config.keep_support,
        "box": config.box is not None,
    }
    return [f"--dataset.{name}" for name, is_given in given.items() if is_given]


def _is_unposed(data: str) -> bool:
    """Whether it is a video, or a folder of photographs that is no scene and holds none. Raises as ``scene_folder``."""
    if is_video(Path(data).expanduser()):
        return True
    folder = scene_folder(data)
    scenes = [place for place in (folder, *folder.iterdir()) if place.is_dir() and _is_scene(place)]
    return not scenes and holds_photographs(folder)


def _is_scene(folder: Path) -> bool:
    """A folder that may not be looked into, as lost+found, is none."""
    return os.access(folder, os.R_OK | os.X_OK) and any(layout.recognises(folder) for layout in LAYOUTS)


def recognise(data: str) -> Layout:
    """The layout of a folder. Raises DataError if there is no such folder or it has no known layout."""
    folder = scene_folder(data)
    for layout in LAYOUTS:
        if layout.recognises(folder):
            return layout
    below = [path for path in folder.iterdir() if path.is_dir()]
    inside = sorted(path.name for path in below if _is_scene(path))
    found = f"scenes inside it ({', '.join(inside[:4])}): give one of them" if inside else contents(folder)
    known = "; ".join(f"{layout.name} ({layout.mark})" for layout in LAYOUTS)
    raise DataError(f"{data}: not a layout that is known; found {found}; layouts: {known}; or demo, demo:NAME.")
