"""Runs by name: found on disk, read, and told apart by what differs in their configurations."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sculpt_framework.comparison.runs import RunRecord, load_run
from sculpt_framework.errors import DataError

_OTHER_RUN_SAME_METHOD = ("version", "method", "seed", "data", "output", "reference", "device", "threads", "observers")
"""Parts of config.json that make another run, or watch one, but no other method."""
ASIDE = ".aside-"
"""In names of folders that hold what a run left before it started again; a number follows."""
_SHOWN_AT_MOST = 3
"""Differences in a name; more are counted."""


def read_runs(words: Sequence[str]) -> tuple[RunRecord, ...]:
    """The runs that words of a command line name: RUN_DIR, a folder with runs somewhere in it, or LABEL=either.

    A label is what its runs are called as a method. Without one, runs of one method whose configurations differ are
    called by what differs. Every run has a name of its own; one that is named twice counts once. Raises DataError where
    there is no run.
    """
    labelled: dict[Path, tuple[RunRecord, bool]] = {}
    for word in words:
        label, folder = _split(word)
        found = list(run_folders(folder))
        if not found:
            raise DataError(f"{folder}: no run in it, no config.json at any depth; give what sculpt-train wrote.")
        for each in found:
            record = load_run(each)
            named = record if label is None else replace(record, method=label)
            labelled.setdefault(each.resolve(), (named, label is not None))
    plain = iter(told_apart([record for record, given in labelled.values() if not given]))
    return uniquely_named([record if given else next(plain) for record, given in labelled.values()])


def run_folders(folder: Path) -> Iterator[Path]:
    """The folder itself if it is a run directory, else the run directories in it, at any depth, by name; without those
    that were set aside for a run that started again.

    Raises DataError if there is no such folder.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; give a run directory, or a folder with runs in it.")
    if (folder / "config.json").is_file():
        yield folder
        return
    found = {path.parent for path in folder.rglob("config.json")}
    aside = re.compile(rf"{re.escape(ASIDE)}\d+$")
    yield from sorted(each for each in found if not any(map(aside.search, each.relative_to(folder).parts)))


def told_apart(records: Sequence[RunRecord]) -> list[RunRecord]:
    """The same runs, each with a method's name that says what sets it apart from runs of the same method.

    Where all records are of one method, its name is left out: "mlp, flexicubes" and not "gaussian-sculpting (...)".
    """
    alone = len({record.method for record in records}) == 1
    flat = [_flat(record.config) for record in records]
    out = []
    for record, settings in zip(records, flat, strict=True):
        others = [each for other, each in zip(records, flat, strict=True) if other.method == record.method]
        differing = _differing(others)
        if not differing:
            out.append(record)
            continue
        words = [_word(key, settings.get(key)) for key in differing]
        told = ", ".join(words[:_SHOWN_AT_MOST])
        if len(words) > _SHOWN_AT_MOST:
            # Values may be lists.
            variants = [repr([each.get(key) for key in differing]) for each in others]
            number = list(dict.fromkeys(variants)).index(repr([settings.get(key) for key in differing])) + 1
            told = f"variant {number}: {told}, ..."
        out.append(replace(record, method=told if alone else f"{record.method} ({told})"))
    return out


def uniquely_named(records: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
    """The same runs under names that are their folders', with as much of the path as tells them apart."""
    names: list[str] = []
    for record in records:
        parts = record.folder.resolve().parts if record.folder else (record.name,)
        depth = 1
        others = [other.folder.resolve().parts for other in records if other is not record and other.folder]
        while depth < len(parts) and any(other[-depth:] == parts[-depth:] for other in others):
            depth += 1
        names.append("/".join(parts[-depth:]))
    return tuple(replace(record, name=name) for record, name in zip(records, names, strict=True))


def _split(word: str) -> tuple[str | None, Path]:
    """``LABEL=FOLDER`` or ``FOLDER``; a folder whose name has an equals sign is a folder."""
    label, equals, folder = word.partition("=")
    if not equals or Path(word).exists():
        return None, Path(word)
    if not label or not folder:
        raise DataError(f"{word}: expected RUN_DIR or LABEL=RUN_DIR, with something on both sides of the equals sign.")
    return label, Path(folder)


def _differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Keys whose values are not the same everywhere. Of a component that is another one only its type is named."""
    keys = list(dict.fromkeys(key for each in settings for key in each))
    differing = [key for key in keys if len({repr(each.get(key)) for each in settings}) > 1]
    swapped = [key.removesuffix("type") for key in differing if key.endswith(".type")]
    return [key for key in differing if key.endswith(".type") or not any(key.startswith(each) for each in swapped)]


def _word(key: str, value: Any) -> str:
    """A difference for people: the type alone for a component, option and value otherwise."""
    if key.endswith(".type"):
        _, _, member = key.removesuffix(".type").partition(".")
        if not member:
            return str(value)
        return f"without {member}" if value is None else f"with {member}"
    option = (key.partition(".")[2] or key).replace("_", "-")
    if isinstance(value, bool):
        return f"{option} {'on' if value else 'off'}"
    return f"{option} {'none' if value is None else value}"


def _flat(config: Mapping[str, Any]) -> dict[str, Any]:
    """Values by their dotted path. Members of a list of components go by their type, so that order does not matter."""
    out: dict[str, Any] = {}

    def walk(prefix: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for key, item in value.items():
                walk(f"{prefix}.{key}" if prefix else key, item)
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            named = all("type" in item for item in value)
            for index, item in enumerate(value):
                walk(f"{prefix}.{item['type'] if named else index}", item)
        else:
            out[prefix] = value

    for key, value in config.items():
        if key not in _OTHER_RUN_SAME_METHOD:
            walk(key, value)
    return out
