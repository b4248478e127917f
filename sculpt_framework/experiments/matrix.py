"""The matrix of an experiment: the runs it consists of, each as the command line it stands for."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sculpt_framework.command_line.request import parse
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.output import scene_name
from sculpt_framework.errors import ConfigError, OutputError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.export.json_text import json_text

MATRIX_NAME = "matrix.json"
MATRIX_SCHEMA = 1
MATRIX_OPTIONS = ("--data", "--output", "--seed", "--resume", "--max-time", "--steps", "--config")
"""What a matrix sets itself, run by run."""


@dataclass(frozen=True, kw_only=True)
class Budget:
    """What every run of a comparison is given alike."""

    kind: str
    """seconds: wall time from the start of the process to the saved mesh; steps: outer steps."""
    amount: float

    @property
    def label(self) -> str:
        return f"{self.amount:g}s" if self.kind == "seconds" else f"{self.amount:g}steps"

    @property
    def phrase(self) -> str:
        return f"{self.amount:g} s" if self.kind == "seconds" else f"{self.amount:g} outer steps"

    @property
    def words(self) -> tuple[str, ...]:
        if self.kind == "seconds":
            return ("--max-time", f"{self.amount:g}")
        return ("--steps", f"{self.amount:.0f}")


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One of the things that are compared."""

    name: str
    method: str
    words: tuple[str, ...] = ()
    """What it adds to the method's command line."""
    replaces: tuple[str, ...] = ()
    """Options that its words stand in for, or that belong to a component it leaves out: ``--field``, or with all that
    begins so, ``--field.``. The words the user gave for all runs lose these."""


@dataclass(frozen=True, kw_only=True)
class MatrixScene:
    """A scene to run on."""

    label: str
    """Short name, unique in the matrix."""
    data: str
    """As given to ``--data``: a demo name or the absolute path of a folder."""
    words: tuple[str, ...] = ()
    """What the scene adds to the command line, as ``--reference FILE``."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run."""

    name: str
    """Where the run goes below the experiment's folder, and what it is called: SCENE/BUDGET/SETTING/seed-N."""
    scene: str
    """Label of the scene."""
    setting: str
    """Name of the setting; cells of one scene, budget and setting differ by their seed."""
    budget: Budget | None
    """None: as many steps as the method says."""
    seed: int
    words: tuple[str, ...]
    """Words for ``sculpt-train``, without ``--output``."""

    @property
    def timed(self) -> bool:
        """The run is given wall seconds, so that going on with half of it would give it others than its rivals."""
        return self.budget is not None and self.budget.kind == "seconds"


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """What an experiment runs."""

    title: str
    cells: tuple[Cell, ...]
    warm_ups: Mapping[str, tuple[str, ...]]
    """Words of a short run by a scene's label, of the first scene and of each that is rendered, that is thrown away, so
    that no run that counts renders a demo scene or compiles kernels."""


def cross(
    title: str,
    settings: Sequence[Setting],
    scenes: Sequence[MatrixScene],
    budgets: Sequence[Budget | None],
    seeds: Sequence[int],
    extra: Sequence[str],
) -> Matrix:
    """Every setting on every scene with every budget and seed. ``extra`` goes to all of them.

    Cells come scene by scene, and within a scene all settings of a seed before the next seed, so that what there is
    after an early end can be compared. Raises ConfigError where a command line would not be valid.
    """
    cells = tuple(
        Cell(
            name="/".join(
                folder_name(part)
                for part in (scene.label, budget.label if budget else "full", setting.name, f"seed-{seed}")
            ),
            scene=scene.label,
            setting=setting.name,
            budget=budget,
            seed=seed,
            words=(
                *_start_of(setting, scene, extra),
                *(budget.words if budget else ()),
                *("--seed", str(seed)),
            ),
        )
        for scene in scenes
        for budget in budgets
        for seed in seeds
        for setting in settings
    )
    short = config_of(settings[0], scenes[0], extra).short_words()
    first = {scene.data: scene for scene in reversed(scenes)}
    warmed = [scene for scene in first.values() if scene is scenes[0] or not Path(scene.data).exists()]
    warm_ups = {scene.label: (*_start_of(settings[0], scene, extra), *short) for scene in warmed}
    return Matrix(title=title, cells=cells, warm_ups=warm_ups)


def config_of(setting: Setting, scene: MatrixScene, extra: Sequence[str]) -> MethodConfig:
    """The config a setting stands for, found without torch. Raises ConfigError, naming the setting."""
    try:
        return parse(_start_of(setting, scene, extra))
    except ConfigError as error:
        raise type(error)(f"{setting.name}: {error}") from error


def _start_of(setting: Setting, scene: MatrixScene, extra: Sequence[str]) -> tuple[str, ...]:
    kept = without_options(extra, setting.replaces)
    return (setting.method, "--data", scene.data, *scene.words, *kept, *setting.words)


def without_options(words: Sequence[str], options: Sequence[str]) -> tuple[str, ...]:
    """Words without some options and their values; an option that ends in a dot stands for all that begin with it."""
    kept: list[str] = []
    dropping = False
    for word in words:
        if word.startswith("--"):
            option = word.partition("=")[0]
            dropping = any(option.startswith(each) if each.endswith(".") else option == each for each in options)
        if not dropping:
            kept.append(word)
    return tuple(kept)


def matrix_scenes(scenes: Sequence[str]) -> tuple[MatrixScene, ...]:
    """Scenes as given to ``--data``, each with a short name; those that would be called the same get a number.

    Raises ConfigError for none, for one that is given twice, and for one that is neither a folder nor a demo.
    """
    if not scenes:
        raise ConfigError("no scenes to run; expected demo names or folders.")
    found: dict[str, MatrixScene] = {}
    for scene in scenes:
        data = absolute_data(scene)
        if data in (each.data for each in found.values()):
            raise ConfigError(f"scene {scene} is given twice.")
        plain = label = folder_name(scene_name(data))
        number = 1
        while label in found:
            number += 1
            label = f"{plain}-{number}"
        found[label] = MatrixScene(label=label, data=data)
    return tuple(found.values())


def absolute_data(data: str) -> str:
    """``--data`` so that it holds wherever the run is started from; names of demo scenes stay what they are.

    Raises ConfigError if it is neither a demo's name nor a folder.
    """
    if data.partition(":")[0] == "demo":
        return data
    if not os.path.isdir(data):
        raise ConfigError(f"scene {data}: no such folder; expected a scene folder, demo or demo:NAME.")
    return os.path.abspath(data)


def check_extra(extra: Sequence[str]) -> None:
    """Raise ConfigError where the user's own words set what the matrix sets run by run."""
    for word in extra:
        option = word.partition("=")[0].replace("_", "-")
        if option in MATRIX_OPTIONS:
            raise ConfigError(f"{option} cannot be given after --: it is what the runs of the experiment differ in.")


def require(matrix: Matrix, folder: Path) -> None:
    """Raise ConfigError unless the folder holds cells of the matrix, and none of the same name with other words."""
    known = _cells_beside(matrix, folder)
    if not known:
        raise ConfigError(f"--show: there is no experiment in {folder}; leave --show out to run it.")
    if known.keys().isdisjoint(cell.name for cell in matrix.cells):
        raise ConfigError(
            f"--show: {folder} holds another experiment; give another --out, or the options it was begun with."
        )


def remember(matrix: Matrix, folder: Path) -> None:
    """Write the matrix's cells beside those the folder knows already.

    Raises ConfigError if a cell of the same name was planned there with other words: its results answer another
    question. Raises OutputError where the folder cannot be written.
    """
    known = _cells_beside(matrix, folder)
    for cell in matrix.cells:
        known[cell.name] = {
            "scene": cell.scene,
            "setting": cell.setting,
            "budget": cell.budget.label if cell.budget else None,
            "seed": cell.seed,
            "words": list(cell.words),
        }
    document = {"schema": MATRIX_SCHEMA, "title": matrix.title, "cells": known}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}; give another --out.") from error
    write_atomically(folder / MATRIX_NAME, (json_text(document, indent=1) + "\n").encode())


def _cells_beside(matrix: Matrix, folder: Path) -> dict[str, Any]:
    """The cells that the folder knows, none of which is one of the matrix with other words."""
    known = _known_cells(folder / MATRIX_NAME)
    for cell in matrix.cells:
        before = known.get(cell.name)
        if before is not None and tuple(before["words"]) != cell.words:
            raise ConfigError(
                f"{folder} holds another experiment: {cell.name} was run there as 'sculpt-train "
                f"{' '.join(before['words'])}'. Give another --out, or the options it was begun with."
            )
    return known


def _known_cells(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    try:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        if all(isinstance(cell["words"], list) for cell in cells.values()):
            return cells
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass
    raise ConfigError(f"{path} is not the matrix of an experiment; give another --out.")


def folder_name(text: str) -> str:
    """``text`` as part of a path."""
    return re.sub(r"[^\w.+-]+", "-", text).strip("-.") or "setting"
