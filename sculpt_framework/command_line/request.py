"""What a ``sculpt-train`` command line asks for: a new run, a saved one, or the repair of one.

Nothing here imports torch: help and mistakes in options come before that.
"""

import inspect
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from sculpt_framework import registry
from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import CheckpointError, ConfigError, SculptError
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.serialization import read_config, with_file
from sculpt_framework.validation import check

PROGRAM = "sculpt-train"
REPAIR_SHARE = 0.5
"""Outer steps of a repair, as a share of those of the run it repairs."""
MAY_CHANGE_ON_RESUME = ("output", "max_time", "device", "threads", "reference", "observers")


@dataclass(frozen=True, kw_only=True)
class TrainRequest:
    """What a command line asks for."""

    config: MethodConfig
    resume: Path | None = None
    """Run directory to go on with; None: a new run."""


def parse(words: Sequence[str]) -> MethodConfig:
    """The config a command line stands for, as in ``parse(["gaussian-sculpting", "--data", "demo"])``.

    Raises SculptError; exits as tyro does for ``--help`` and for values of a wrong type.
    """
    return read_request(words).config


def read_request(words: Sequence[str]) -> TrainRequest:
    """The run a command line asks for. Reads files for ``--resume`` and ``--config`` alone. Raises and exits as
    ``parse``.
    """
    expected = "a run directory, as in --resume outputs/SCENE/METHOD/TIME"
    resume, words = _take("--resume", expected, words)
    if resume is None and words and words[0] in ("-h", "--help"):
        sys.stdout.write(overview())
        sys.exit(0)
    named = bool(words) and not words[0].startswith("-")
    if not named and resume is None:
        given = f"not with {words[0]}" if words else "as in sculpt-train gaussian-sculpting --data demo"
        raise ConfigError(f"{PROGRAM} starts with a method, {given}. Methods: {', '.join(registry.method_names())}.")
    if resume is None:
        return TrainRequest(config=_new_run(words[0], words[1:]))
    if any(word.partition("=")[0] == "--config" for word in words):
        raise ConfigError("--config cannot be given with --resume: a saved run keeps its settings.")
    method, rest = (words[0], words[1:]) if named else (None, words)
    if any(word.partition("=")[0].replace("_", "-") == "--refine-box" for word in rest):
        return TrainRequest(config=_repair(resume, method, rest))
    return TrainRequest(config=_saved_run(resume, method, rest), resume=resume)


def overview() -> str:
    """The text of ``sculpt-train --help``."""
    names = registry.method_names()
    of_paper = [name for name in names if name.endswith(PAPER) and name.removesuffix(PAPER) in names]
    width = max(map(len, names)) + 2
    lines = [f"  {name:{width}}{_first_line(name)}" for name in names if name not in of_paper]
    if of_paper:
        same = ", ".join(name.removesuffix(PAPER) for name in of_paper)
        lines.append(f"  {'NAME' + PAPER:{width}}The same at the size of its paper, hours on a GPU: {same}.")
    return OVERVIEW.format(methods="\n".join(lines))


PAPER = "-paper"
"""Ends the names of methods that another one has at the size of its paper."""
OVERVIEW = """\
usage: sculpt-train METHOD --data DIR|demo|demo:NAME [options]
       sculpt-train --resume RUN_DIR [options]
       sculpt-train --resume RUN_DIR --refine-box X0 Y0 Z0 X1 Y1 Z1 [options]

Posed images of one object in, a watertight mesh out.

methods:
{methods}

options of every method:
  --data DIR|demo|demo:NAME    the scene: a folder, or one that is built in
  --output DIR                 where results go (default: outputs/SCENE/METHOD/TIME)
  --max-time SECONDS           plan the run to end by then, mesh saved
  --device auto|cpu|cuda  --threads N  --seed N  --reference MESH  --viewer
  --SLOT NAME                  swap a component: {slots}
  --SLOT.OPTION VALUE          set a component's option
  --config FILE.json           take settings from a file: a run's config.json, or a part of one

sculpt-train METHOD --help lists what a person sets, --help-all every option, with defaults.
""".replace("{slots}", f"\n{' ' * 31}".join(textwrap.wrap(", ".join(registry.SLOTS), width=60)))


def _new_run(method: str, words: Sequence[str]) -> MethodConfig:
    config, description = _make_config(method)
    file, words = _take("--config", "a JSON file, as in --config settings.json", words)
    if file is not None:
        config = with_file(config, file)
    config = _edit(config, words, f"{PROGRAM} {config.method}", description)
    if not config.data:
        raise ConfigError("--data is missing: give a folder, as in --data DIR, or --data demo.")
    return config


def _saved_run(run_dir: Path, method: str | None, words: Sequence[str]) -> MethodConfig:
    """The config of the run in ``run_dir``, with what may change on resuming changed."""
    saved = _read_saved(run_dir, method)
    config = _edit(replace(saved, output=None), words, f"{PROGRAM} --resume {run_dir}", "Go on with a saved run.")
    if config.output is not None:
        raise ConfigError("--output cannot be given with --resume: results go where the run is.")
    _check_unchanged(run_dir, saved, config, MAY_CHANGE_ON_RESUME)
    return replace(config, output=run_dir)


def _repair(run_dir: Path, method: str | None, words: Sequence[str]) -> MethodConfig:
    """The config of a new run that goes on with the finished one in ``run_dir``, in the boxes the words give."""
    saved = _read_saved(run_dir, method)
    if not isinstance(saved, SculptingConfig):
        raise ConfigError(f"--refine-box: runs of {saved.method!r} cannot be refined in boxes.")
    last, steps = saved.trainer.stages[-1], max(1, round(REPAIR_SHARE * saved.steps))
    plain = replace(
        saved,
        output=None,
        max_time=None,
        refine_box=(),
        refine_box_levels=1,
        replay=None,
        repair=run_dir.absolute(),
        steps=steps,
        trainer=replace(saved.trainer, stages=(last,)),
    )
    config = _edit(plain, words, f"{PROGRAM} --resume {run_dir}", "Refine a finished run in boxes.")
    _check_unchanged(run_dir, plain, config, (*MAY_CHANGE_ON_RESUME, "steps", "refine_box", "refine_box_levels"))
    return config if config.output is not None else replace(config, output=_repaired_folder(run_dir))


def _repaired_folder(run_dir: Path) -> Path:
    """A new folder beside the run's; it is not made yet."""
    stem = run_dir.absolute()
    number = 1
    while (folder := stem.with_name(f"{stem.name}-repair-{number}")).exists():
        number += 1
    return folder


def _read_saved(run_dir: Path, method: str | None) -> MethodConfig:
    path = run_dir / "config.json"
    if not path.is_file():
        raise CheckpointError(f"--resume {run_dir}: there is no saved run ({path} does not exist).")
    saved = read_config(path)
    if method is not None and method != saved.method:
        raise ConfigError(f"--resume {run_dir} is a run of {saved.method!r}, not of {method!r}. Leave the method out.")
    return saved


def _check_unchanged(run_dir: Path, saved: MethodConfig, config: MethodConfig, may_change: Sequence[str]) -> None:
    for each in fields(saved):
        if each.name not in may_change and getattr(config, each.name) != getattr(saved, each.name):
            raise ConfigError(
                f"--resume {run_dir}: {each.name} cannot be changed in a saved run. Start a new run for that."
            )


def _edit(config: MethodConfig, words: Sequence[str], program: str, description: str) -> MethodConfig:
    # tyro takes 60 ms to import, which the overview does not need.
    from sculpt_framework.command_line.options import apply_words

    config = apply_words(config, words, program, description)
    check(config)
    if config.reference is not None and not config.reference.is_file():
        raise ConfigError(f"--reference {config.reference} is not a file. Give a mesh: .ply, .obj, .glb or .stl.")
    return config


def _make_config(method: str) -> tuple[MethodConfig, str]:
    """The method's config and what its function says about it."""
    make = registry.load_method(method)
    config = make()
    if not isinstance(config, MethodConfig):
        raise ConfigError(f"method {method!r} returned {type(config).__name__}, not a MethodConfig.")
    name = registry.spelled(method, registry.method_names()) or method
    return replace(config, method=name), inspect.getdoc(make) or name


def _first_line(method: str) -> str:
    try:
        return (inspect.getdoc(registry.load_method(method)) or "").partition("\n")[0]
    except SculptError as error:
        return f"(not available: {error.__cause__ or error})"


def _take(name: str, expected: str, words: Sequence[str]) -> tuple[Path | None, list[str]]:
    """The path that the option ``name`` has, and the other words."""
    rest, found = list(words), None
    for index, word in enumerate(rest):
        option, equals, value = word.partition("=")
        if option != name:
            continue
        end = index + 1 if equals else index + 2
        value = value if equals else next(iter(rest[index + 1 : end]), "")
        if not value or value.startswith("--"):
            raise ConfigError(f"{name} expects {expected}.")
        found = Path(value)
        del rest[index:end]
        if any(word.partition("=")[0] == name for word in rest):
            raise ConfigError(f"{name} is given twice. Give it once.")
        break
    return found, rest
