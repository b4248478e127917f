"""``sculpt-export``: the results of a run in the format another program wants.

Formats are plug-ins: ``--format`` names one, and its config's fields are the options there are beside it.
"""

import inspect
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from sculpt_framework import registry
from sculpt_framework.cli import exit_codes
from sculpt_framework.config import ExporterConfig
from sculpt_framework.errors import ConfigError, SculptError

_PROGRAM = "sculpt-export"
_FORMAT = "--format"


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    run_dir: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_DIR")]
    """Run directory."""
    format: Annotated[str, tyro.conf.arg(metavar="FORMAT", help_behavior_hint="")]
    """Another format has other options: sculpt-export --help lists them all."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """What to write. Default: a file in the run directory, named after what is asked for."""


def main() -> None:
    """The console script ``sculpt-export``."""
    exit_codes.run(lambda: export(sys.argv[1:]))


def export(words: Sequence[str]) -> None:
    """Write the file and say where it is. Raises SculptError; exits as tyro does for ``--help``."""
    name = _format_named(words)
    if name is None:
        if not words or "--help" in words or "-h" in words:
            sys.stdout.write(overview())
            return
        raise ConfigError(f"--format is missing; there are {', '.join(registry.export_formats())}.")
    request, config = _read(words, name)
    exporter = config.build()
    for line in exporter.write(request.run_dir, request.out or request.run_dir / config.file_name):
        sys.stdout.write(f"{line}\n")


def overview() -> str:
    """The text of ``sculpt-export --help``."""
    formats = registry.export_formats()
    width = max(map(len, formats)) + 2
    listed = "\n".join(f"  {name:{width}}{_first_sentence(name)}" for name in formats)
    return _OVERVIEW.format(formats=listed)


_OVERVIEW = """\
usage: sculpt-export RUN_DIR --format FORMAT [--out FILE] [options]

The mesh or the Gaussians of a run, or pictures of the mesh, in the format another program wants.

formats:
{formats}

sculpt-export --format FORMAT --help lists a format's options.
"""


def _format_named(words: Sequence[str]) -> str | None:
    """What ``--format`` says. Raises ConfigError where it says nothing, or is given twice."""
    found: list[str] = []
    for index, word in enumerate(words):
        option, equals, value = word.partition("=")
        if option == _FORMAT:
            found.append(value if equals else next(iter(words[index + 1 : index + 2]), ""))
    if not found:
        return None
    if len(found) > 1:
        raise ConfigError(f"--format is given twice: {' and '.join(found)}. One file at a time.")
    if not found[0] or found[0].startswith("-"):
        raise ConfigError(f"--format expects a name: {', '.join(registry.export_formats())}.")
    return found[0]


def _read(words: Sequence[str], name: str) -> tuple[ExportRequest, ExporterConfig]:
    default = registry.default_exporter(name)
    kind = make_dataclass(
        "Request",
        [("options", Annotated[type(default), tyro.conf.arg(name="")], field(default=default))],
        bases=(ExportRequest,),
        frozen=True,
        kw_only=True,
    )
    request, unknown = tyro.cli(
        kind,
        args=_with_values_attached(words),
        prog=_PROGRAM,
        description=inspect.getdoc(type(default)) or name,
        return_unknown_args=True,
        config=(tyro.conf.HelptextFromCommentsOff, tyro.conf.FlagCreatePairsOff),
    )
    if unknown:
        raise ConfigError(_explain_unknown(unknown[0], name, default))
    return request, request.options


def _with_values_attached(words: Sequence[str]) -> list[str]:
    """``--up -Y`` as ``--up=-Y``: a value may begin with a dash."""
    out: list[str] = []
    for word in words:
        if out and out[-1] == "--up" and not word.startswith("--"):
            out[-1] = f"--up={word}"
        else:
            out.append(word)
    return out


def _explain_unknown(word: str, name: str, config: ExporterConfig) -> str:
    if not word.startswith("-"):
        return f"{word!r} belongs to no option; {_PROGRAM} takes one run directory. --help lists the options."
    option = word.partition("=")[0].removeprefix("--").replace("_", "-")
    others = [other for other in registry.export_formats() if option in _options(other)]
    if others:
        return f"--{option} goes with --format {_listed(others)}, not {name}."
    near = registry.closest(option, ("out", "format", *_options_of(config)))
    hint = f" Did you mean --{near}?" if near else ""
    return f"--format {name} has no option --{option}.{hint} {_PROGRAM} --format {name} --help lists them."


def _options(name: str) -> tuple[str, ...]:
    """Of a format; none if its package is broken: it was not asked for."""
    try:
        return _options_of(registry.default_exporter(name))
    except SculptError:
        return ()


def _options_of(config: Any) -> tuple[str, ...]:
    return tuple(each.name.replace("_", "-") for each in fields(config))


def _listed(names: Sequence[str]) -> str:
    return " or ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]


def _first_sentence(name: str) -> str:
    try:
        text = inspect.getdoc(type(registry.default_exporter(name))) or ""
        return " ".join(text.partition("\n\n")[0].split())
    except SculptError as error:
        return f"(not available: {error.__cause__ or error})"


if __name__ == "__main__":
    main()
