"""What a person may tell a run while it goes on: a small closed set, each as one JSON object under "do".

Commands are recorded in the events of the run ("action" with a "command"), so that another run can be told the same at
the same outer steps: ``--replay events.jsonl``.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

from sculpt_framework.errors import ConfigError

MAX_RATE_FACTOR = 100.0
MAX_WEIGHT = 1e6


@dataclass(frozen=True, kw_only=True)
class Pause:
    """Take no step until told to go on."""


@dataclass(frozen=True, kw_only=True)
class Resume:
    """Go on after a pause."""


@dataclass(frozen=True, kw_only=True)
class Stop:
    """End after this step and save, as Ctrl-C does."""


@dataclass(frozen=True, kw_only=True)
class SetWeight:
    """Give a term of the objectives another weight."""

    slot: Literal["losses", "constraints"]
    name: str
    weight: float


@dataclass(frozen=True, kw_only=True)
class SwitchConstraint:
    """Leave a constraint out, or take it in again with the weight it has."""

    name: str
    on: bool


@dataclass(frozen=True, kw_only=True)
class SetRate:
    """Multiply the learning rates that the schedule gives: of field and extractor, or of the Gaussians."""

    part: Literal["surface", "gaussians"]
    factor: float


@dataclass(frozen=True, kw_only=True)
class AddBox:
    """Treat the surface in a box (world frame) otherwise.

    refine: cells of half the size. freeze: the signed distance and the extractor's weights stay what they are. ignore:
    images teach nothing about the surface there.
    """

    kind: Literal["refine", "freeze", "ignore"]
    minimum: tuple[float, float, float]
    maximum: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class ClearBoxes:
    """Take back every box that was added while the run went on."""


@dataclass(frozen=True, kw_only=True)
class ExportMesh:
    """Write the mesh as it is into RUN_DIR/exports."""


@dataclass(frozen=True, kw_only=True)
class TakeSnapshot:
    """Tell the current surface in a "snapshot" event. Changes nothing and is not recorded."""


Command = (
    Pause | Resume | Stop | SetWeight | SwitchConstraint | SetRate | AddBox | ClearBoxes | ExportMesh | TakeSnapshot
)
LASTING = (SetWeight, SwitchConstraint, SetRate, AddBox, ClearBoxes)
"""Commands that change what later steps do; a resumed run starts from them."""
_KINDS = {
    re.sub(r"(?<!^)([A-Z])", r"-\1", kind.__name__).lower(): kind
    for kind in (
        Pause,
        Resume,
        Stop,
        SetWeight,
        SwitchConstraint,
        SetRate,
        AddBox,
        ClearBoxes,
        ExportMesh,
        TakeSnapshot,
    )
}
_NAMES = {kind: name for name, kind in _KINDS.items()}
_CHOICES: Mapping[str, Sequence[str]] = {
    "slot": ("losses", "constraints"),
    "part": ("surface", "gaussians"),
    "kind": ("refine", "freeze", "ignore"),
}


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A command of an earlier run and the number of outer steps after which it was obeyed."""

    outer: int
    command: Command


def command_to_json(command: Command) -> dict[str, Any]:
    """JSON values; ``command_from_json`` is the inverse."""
    return {"do": _NAMES[type(command)], **asdict(command)}


def command_from_json(value: object) -> Command:
    """Raises ConfigError, naming what is wrong, for anything that is not a valid command."""
    if not isinstance(value, dict) or value.get("do") not in _KINDS:
        raise ConfigError(f"{json.dumps(value)[:200]} is no command; expected one of {', '.join(_KINDS)} under 'do'.")
    kind = _KINDS[value["do"]]
    wanted, given = {each.name for each in fields(kind)}, set(value) - {"do"}
    if wanted != given:
        raise ConfigError(f"command {value['do']} takes {sorted(wanted) or 'nothing'}, not {sorted(given)}.")
    arguments = {name: _checked(value["do"], name, value[name]) for name in wanted}
    command = kind(**arguments)
    if isinstance(command, AddBox) and not all(a < b for a, b in zip(command.minimum, command.maximum, strict=True)):
        raise ConfigError(f"the box from {command.minimum} to {command.maximum} is empty; expected minimum < maximum.")
    return command


def read_recorded(path: Path) -> list[Recorded]:
    """The commands in an events.jsonl that changed the run, in order; without pauses and exports of meshes.

    Raises ConfigError if the file cannot be read, is of something else, or a command in it is not valid. Half a line at
    the end, which a killed run may leave, is passed over.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--replay {path} cannot be read ({error}); expected the events.jsonl of a run.") from error
    out: list[Recorded] = []
    events = 0
    for line in lines:
        try:
            event = json.loads(line)
        except ValueError:
            continue
        events += isinstance(event, dict) and "event" in event
        if not isinstance(event, dict) or event.get("event") not in ("action", "stage", "outer_step"):
            continue
        # A run resumed from a checkpoint did again what it had done after it, without these commands.
        out = [recorded for recorded in out if recorded.outer <= event["outer"]]
        data = event["data"]
        if event["event"] != "action" or "command" not in data or data.get("refused"):
            continue
        command = command_from_json(data["command"])
        if isinstance(command, (*LASTING, Stop)):
            out.append(Recorded(outer=int(event["outer"]), command=command))
    if events == 0 and len(lines) > 1:
        raise ConfigError(f"--replay {path} holds no events; expected the events.jsonl of a run.")
    return out


def _checked(command: str, name: str, value: object) -> Any:
    if name in _CHOICES:
        if value not in _CHOICES[name]:
            raise ConfigError(f"{name} of command {command} is {value!r}; expected {' or '.join(_CHOICES[name])}.")
        return value
    if name == "on":
        return _require(isinstance(value, bool), command, name, value, "true or false")
    if name == "name":
        return _require(isinstance(value, str), command, name, value, "a name")
    if name == "weight":
        number = _number(value)
        return _require(0 <= number <= MAX_WEIGHT, command, name, number, f"0 to {MAX_WEIGHT:g}")
    if name == "factor":
        number = _number(value)
        return _require(0 <= number <= MAX_RATE_FACTOR, command, name, number, f"0 to {MAX_RATE_FACTOR:g}")
    numbers = tuple(_number(each) for each in value) if isinstance(value, (list, tuple)) else ()
    return _require(
        len(numbers) == 3 and all(map(math.isfinite, numbers)), command, name, numbers or value, "three numbers"
    )


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else math.nan


def _require(holds: bool, command: str, name: str, value: Any, expected: str) -> Any:
    if not holds:
        raise ConfigError(f"{name} of command {command} is {value!r}; expected {expected}.")
    return value
