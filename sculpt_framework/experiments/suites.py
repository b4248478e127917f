"""Named sets of scenes: which there are, where their files lie, and which table of the paper they answer."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from sculpt_framework.config import DatasetConfig
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.experiments.matrix import MatrixScene, absolute_data, folder_name
from sculpt_framework.experiments.paper import NERF_SYNTHETIC, OMNIOBJECT3D, PaperTable

Masks = Literal["with", "without", "both"]
WITHOUT_MASKS = "-without-masks"
"""What the label of a capture whose masks are ignored ends in."""
_MESHES = (".ply", ".obj", ".glb", ".stl", ".off")
OMNIOBJECT3D_CATEGORIES = tuple(name.lower() for name in OMNIOBJECT3D.objects)
"""The paper names objects by their category in the dataset, and does not say which scans it took."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Scenes to run on, and what to show the results beside."""

    name: str
    scenes: tuple[MatrixScene, ...]
    columns: tuple[str, ...]
    """What the columns of the table are called, one per scene."""
    missing: tuple[str, ...]
    """Objects of the paper's table that the folder does not have."""
    paper: PaperTable | None
    unit: float
    """Of the Chamfer distances in the table."""
    left_out: tuple[str, ...] = ()
    """Folders that are no scenes."""


def find_suite(
    name: str, folder: Path | None, objects: Sequence[str], references: Path | None, masks: Masks = "with"
) -> Suite:
    """The scenes of a suite.

    ``objects`` chooses among them; none: the paper's, or all demo scenes and captures. ``references`` is a folder with
    a mesh per scene, NAME.ply or so, for data that bring none. ``masks``: whether captures that have masks are taken
    with them, as if they had none, or as two scenes. Raises ConfigError, with what was found, where that is not there.
    """
    if len(set(objects)) < len(objects):
        raise ConfigError(f"--objects {' '.join(objects)}: expected each once.")
    if name == "demo":
        if folder is not None or references is not None:
            raise ConfigError("the suite demo needs no folder: its scenes and their references are built in.")
        return _demo(objects)
    if folder is None:
        raise ConfigError(f"the suite {name} needs the folder of the data: sculpt-bench suite {name} DIR.")
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; expected the data of the suite {name}.")
    if references is not None and not references.is_dir():
        raise ConfigError(f"--references {references}: no such folder; expected meshes called as the scenes are.")
    if name == "blender":
        return _blender(folder, objects, references)
    if references is not None:
        source = "raw_scans" if name == "omniobject3d" else "gt_mesh.ply in each capture's folder"
        raise ConfigError(f"the suite {name} takes its references from {source}; leave --references out.")
    return _captures(folder, objects, masks) if name == "captures" else _omniobject3d(folder, objects)


def _demo(objects: Sequence[str]) -> Suite:
    # numpy comes with it, which no help text needs.
    from sculpt_framework.demo_scenes.objects import OBJECTS

    unknown = [name for name in objects if name not in OBJECTS]
    if unknown:
        raise ConfigError(f"--objects {unknown[0]}: no such demo scene; there are {', '.join(OBJECTS)}.")
    names = tuple(objects or OBJECTS)
    scenes = tuple(MatrixScene(label=name, data=f"demo:{name}") for name in names)
    return Suite(name="demo", scenes=scenes, columns=names, missing=(), paper=None, unit=1e-2)


def _blender(folder: Path, objects: Sequence[str], references: Path | None) -> Suite:
    """Folders in NeRF-Synthetic layout: the paper's five by default."""
    there = {path.name: path for path in sorted(folder.iterdir()) if (path / "transforms_train.json").is_file()}
    wanted = tuple(objects or (name.lower() for name in NERF_SYNTHETIC.objects))
    found = [name for name in wanted if name in there]
    missing = tuple(name for name in wanted if name not in there)
    if objects and missing:
        raise ConfigError(f"--objects {missing[0]}: {folder} has no such scene; there are {_listed(there)}.")
    if not found:
        raise ConfigError(
            f"{folder} has none of the paper's scenes ({', '.join(wanted)}); there are {_listed(there)}. "
            "Name others by --objects."
        )
    scenes = []
    for name in found:
        words = () if references is None else ("--reference", str(_mesh(references, name)))
        scenes.append(MatrixScene(label=name, data=absolute_data(str(there[name])), words=words))
    return Suite(
        name="blender", scenes=tuple(scenes), columns=tuple(found), missing=missing, paper=NERF_SYNTHETIC, unit=1e-2
    )


def _omniobject3d(folder: Path, objects: Sequence[str]) -> Suite:
    """Objects of the released folders; of the paper's categories by default, the first by number of each."""
    there = dict(_omniobject3d_objects(folder))
    if not there:
        raise ConfigError(
            f"{folder} has no objects in the layout of OmniObject3D; expected "
            "blender_renders/CATEGORY/OBJECT/render/transforms.json in it."
        )
    chosen: dict[str, Path] = {}
    missing = []
    for name in objects or OMNIOBJECT3D_CATEGORIES:
        matching = [key for key in there if name in (key, category_of(key))]
        if matching:
            first = min(matching, key=_by_number)
            chosen[first] = there[first]
        elif objects:
            raise ConfigError(f"--objects {name}: {folder} has neither such an object nor such a category.")
        else:
            missing.append(name)
    if not chosen:
        raise ConfigError(f"{folder} has none of the paper's categories; there are {_listed(there)}.")
    scenes = tuple(MatrixScene(label=name, data=absolute_data(str(path))) for name, path in chosen.items())
    return Suite(
        name="omniobject3d",
        scenes=scenes,
        columns=tuple(chosen),
        missing=tuple(missing),
        paper=OMNIOBJECT3D,
        unit=1e-3,
    )


def _captures(folder: Path, objects: Sequence[str], masks: Masks) -> Suite:
    """Every folder in ``folder`` that the dataset auto reads, once or, with and without its masks, twice."""
    from sculpt_framework.posed_images.masks import has_mask_files

    folders = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    there = {path.name: path for path in folders if _is_scene(path)}
    unknown = [name for name in objects if name not in there]
    if unknown:
        raise ConfigError(f"--objects {unknown[0]}: {folder} has no such capture; there are {_listed(there)}.")
    if not there:
        raise ConfigError(f"{folder} holds no captures; expected folders that sculpt-train --data can read, each one.")
    scenes = []
    for name in objects or there:
        label, data = folder_name(name), absolute_data(str(there[name]))
        masked = has_mask_files(there[name])
        if masks != "without" or not masked:
            scenes.append(MatrixScene(label=label, data=data))
        if masks != "with" and masked:
            words = ("--dataset.masks", "ignored")
            scenes.append(MatrixScene(label=f"{label}{WITHOUT_MASKS}", data=data, words=words))
    labels = [scene.label for scene in scenes]
    if twice := sorted({label for label in labels if labels.count(label) > 1}):
        raise ConfigError(f"{folder}: two captures would be called {twice[0]}; rename one of the folders.")
    return Suite(
        name="captures",
        scenes=tuple(scenes),
        columns=tuple(scene.label for scene in scenes),
        missing=(),
        paper=None,
        unit=1e-2,
        left_out=tuple(path.name for path in folders if path.name not in there),
    )


def _is_scene(folder: Path) -> bool:
    from sculpt_framework import registry

    try:
        dataset = cast("DatasetConfig", registry.default("dataset", "auto")).build(str(folder))
    except DataError:
        return False
    # A folder of photographs is no capture yet; a suite writes nothing beside its data.
    return not dataset.lacks_cameras


def paper_column(paper: PaperTable, column: str) -> int | None:
    """Which column of the paper's table a scene belongs to, by its name or its category."""
    names = [name.lower() for name in paper.objects]
    for key in (column.lower(), category_of(column).lower()):
        if key in names:
            return names.index(key)
    return None


def category_of(name: str) -> str:
    """``toy_plane`` of ``toy_plane_007``."""
    return re.sub(r"_\d+$", "", name)


def _omniobject3d_objects(folder: Path) -> Iterator[tuple[str, Path]]:
    """Names and folders of objects, with or without the level of categories."""
    root = folder / "blender_renders"
    for transforms in sorted((root if root.is_dir() else folder).glob("**/render/transforms.json")):
        place = transforms.parent.parent
        yield place.name, place


def _by_number(name: str) -> tuple[int, str]:
    number = re.search(r"_(\d+)$", name)
    return (int(number[1]) if number else 0, name)


def _mesh(folder: Path, name: str) -> Path:
    for suffix in _MESHES:
        path = folder / f"{name}{suffix}"
        if path.is_file():
            return path.absolute()
    raise ConfigError(f"--references {folder}: no mesh for {name}; expected {name}.ply, .obj, .glb, .stl or .off.")


def _listed(names: Sequence[str] | dict[str, Path]) -> str:
    shown = list(names)
    return (", ".join(shown[:8]) + (", ..." if len(shown) > 8 else "")) if shown else "none"
